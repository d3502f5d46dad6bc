/* Firmware of the system that rtl/soc/system.py describes: renders the frame image that lies in main memory, with the driver of
 * examples/driver, and says over the serial line how long the frame took.
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stddef.h>

#include "msv2_driver.h"

#define REGISTERS 0x10000000u
#define SERIAL 0x20000000u
#define STATUS 0x20000004u
#define MAIN 0x40000000u /* here begins the memory that the machine sees from address 0 on */
#define MAIN_BYTES 0x02000000u

#ifndef IMAGE
#define IMAGE 0x01000000u /* where in main memory the frame image lies, which something else has put there */
#endif
#ifndef DRAM
#define DRAM 0x00040000u /* where the frame's memory begins */
#endif
#ifndef CLOCK_KHZ
#define CLOCK_KHZ 50000u
#endif

#define RUNNING 1u /* the port `status`; a failure is FAILED plus the driver's result */
#define DONE 2u
#define FAILED 0x80u

static volatile uint32_t *word(uint32_t address)
{
    return (volatile uint32_t *)(uintptr_t)address;
}

static uint32_t cycles(void)
{
    uint32_t value;

    __asm__ volatile("rdcycle %0" : "=r"(value));
    return value;
}

uint32_t msv2_read(void *port, uint32_t offset)
{
    (void)port;
    return *word(REGISTERS + offset);
}

void msv2_write(void *port, uint32_t offset, uint32_t value)
{
    (void)port;
    *word(REGISTERS + offset) = value;
}

void msv2_store(void *port, uint32_t address, const uint8_t *bytes, uint32_t count)
{
    uint32_t place;

    (void)port;
    if ((((uint32_t)(uintptr_t)bytes | address | count) & 3u) == 0) {
        const uint32_t *from = (const uint32_t *)(const void *)bytes;
        volatile uint32_t *to = word(MAIN + address);

        for (place = 0; place < count / 4u; place++)
            to[place] = from[place];
        return;
    }
    for (place = 0; place < count; place++)
        ((volatile uint8_t *)(uintptr_t)(MAIN + address))[place] = bytes[place];
}

int msv2_wait(void *port, uint32_t timeout)
{
    uint32_t begin = cycles();

    while (msv2_read(port, MSV2_INTERRUPT) == 0)
        if (cycles() - begin > timeout * CLOCK_KHZ)
            return 0;
    return 1;
}

static void say(const char *text)
{
    for (; *text != '\0'; text++)
        *word(SERIAL) = (uint8_t)*text;
}

static void say_number(const char *name, uint32_t value)
{
    static const char digits[] = "0123456789abcdef";
    int shift;

    say(name);
    say(" 0x");
    for (shift = 28; shift >= 0; shift -= 4)
        *word(SERIAL) = (uint8_t)digits[value >> shift & 15u];
    say("\n");
}

static uint32_t failed(const char *what, enum msv2_result result)
{
    say("failed: ");
    say_number(what, (uint32_t)result);
    return FAILED | (uint32_t)result;
}

static uint32_t frame(void)
{
    struct msv2_machine machine;
    struct msv2_image image;
    struct msv2_failure failure;
    enum msv2_result result;
    uint32_t begun;

    if ((result = msv2_probe(NULL, &machine)) != MSV2_OK)
        return failed("probe", result);
    say_number("fingerprint", machine.fingerprint);
    if ((result = msv2_image_open(&image, (const uint8_t *)(uintptr_t)(MAIN + IMAGE), MAIN_BYTES - IMAGE)) != MSV2_OK)
        return failed("image", result);
    if ((result = msv2_load(NULL, &machine, &image, DRAM)) != MSV2_OK)
        return failed("load", result);
    begun = cycles();
    if ((result = msv2_render(NULL, &image, DRAM, 60000u, &failure)) != MSV2_OK)
        return failed("render", result);
    say_number("cycles", cycles() - begun);
    return DONE;
}

int main(void)
{
    *word(STATUS) = RUNNING;
    *word(STATUS) = frame();
    return 0;
}
