/* The unpacker that msv2_packed.h describes.
 * SPDX-License-Identifier: Apache-2.0
 */
#include "msv2_packed.h"

#include <stddef.h>
#include <string.h>

#define TILE 16u
#define CHANNELS 4u
#define GROUP 8u
#define BLOCK_GROUPS 32u
#define HEADER_BYTES 16u
#define BEAT_BYTES 32u
#define PLAIN_BEATS 8u
#define ALL_PLANES 7u
#define PLANES 8u
#define SIZE_MASK 15u
#define SIZE_BITS 4u
#define STATES 0xFFFu

/* The check's state after 4 bits that are 0, by its highest 4 bits, where the others are 0. */
static const uint16_t check_steps[16] = {
    0x000, 0x053, 0x0A6, 0x0F5, 0x14C, 0x11F, 0x1EA, 0x1B9, 0x298, 0x2CB, 0x23E, 0x26D, 0x3D4, 0x387, 0x372, 0x321,
};

/* Four bits turned round: those of a byte come lowest first. */
static const uint8_t turned[16] = {0, 8, 4, 12, 2, 10, 6, 14, 1, 9, 5, 13, 3, 11, 7, 15};

static uint32_t check_of(const uint8_t *bytes, uint32_t count, uint32_t number)
{
    uint32_t state = (number ^ STATES) & STATES, n;

    for (n = 0; n < count; n++) {
        state = (state << 4 & STATES) ^ check_steps[state >> 8 ^ turned[bytes[n] & 15u]];
        state = (state << 4 & STATES) ^ check_steps[state >> 8 ^ turned[bytes[n] >> 4]];
    }
    return state;
}

/* The code of a group: three bits at any place of the header. */
static uint32_t code_at(const uint8_t *slot, uint32_t group)
{
    uint32_t place = 3u * group, low = slot[CHANNELS + place / 8u];
    uint32_t high = place / 8u < HEADER_BYTES - CHANNELS - 1u ? slot[CHANNELS + place / 8u + 1u] : 0u;

    return (low | high << 8) >> place % 8u & ALL_PLANES;
}

/* A matrix of 8 x 8 bits turned on its diagonal: eight planes, a byte each, become eight differences. */
static uint64_t transposed(uint64_t bits)
{
    uint64_t part = (bits ^ bits >> 7) & UINT64_C(0x00AA00AA00AA00AA);

    bits ^= part ^ part << 7;
    part = (bits ^ bits >> 14) & UINT64_C(0x0000CCCC0000CCCC);
    bits ^= part ^ part << 14;
    part = (bits ^ bits >> 28) & UINT64_C(0x00000000F0F0F0F0);
    return bits ^ part ^ part << 28;
}

/* Eight differences of one channel, from the planes at `at`; the highest plane has the sign. */
static void group_into(uint8_t *pixels, const uint8_t *at, uint32_t planes)
{
    uint64_t bits = 0;
    uint32_t n;

    for (n = 0; n < PLANES && planes; n++)
        bits |= (uint64_t)at[n < planes ? n : planes - 1u] << 8 * n;
    bits = transposed(bits);
    for (n = 0; n < GROUP; n++)
        pixels[CHANNELS * n] = (uint8_t)(bits >> 8 * n & 255u);
}

/* Differences become pixels, in place. */
static void add_up(uint8_t *pixels)
{
    const uint32_t row = CHANNELS * MSV2_PACKED_BLOCK_WIDTH;
    uint32_t n;

    for (n = CHANNELS; n < MSV2_PACKED_SLOT_BYTES; n++)
        if (n % row >= CHANNELS)
            pixels[n] = (uint8_t)(pixels[n] + pixels[n - CHANNELS]);
    for (n = row; n < MSV2_PACKED_SLOT_BYTES; n++)
        pixels[n] = (uint8_t)(pixels[n] + pixels[n - row]);
    for (n = 0; n < MSV2_PACKED_SLOT_BYTES; n += CHANNELS) {
        pixels[n] = (uint8_t)(pixels[n] + pixels[n + 1u]);
        pixels[n + 2u] = (uint8_t)(pixels[n + 2u] + pixels[n + 1u]);
    }
}

uint32_t msv2_packed_bytes(uint32_t width, uint32_t height)
{
    uint64_t tiles = (uint64_t)(width / TILE + (width % TILE > 0)) * (height / TILE + (height % TILE > 0));
    uint64_t bytes = tiles * MSV2_PACKED_BLOCKS * MSV2_PACKED_SLOT_BYTES
                     + (tiles * MSV2_PACKED_BLOCKS * 2u + BEAT_BYTES - 1u) / BEAT_BYTES * BEAT_BYTES;

    return tiles > UINT32_MAX / (MSV2_PACKED_BLOCKS * MSV2_PACKED_SLOT_BYTES) || bytes > UINT32_MAX ? 0u : (uint32_t)bytes;
}

enum msv2_packed_error msv2_unpack_block(const uint8_t *slot, uint32_t entry, uint32_t number, uint8_t *pixels)
{
    uint32_t size = entry & SIZE_MASK, used = 0, plain = size == PLAIN_BEATS, planes, n;
    const uint8_t *at = slot + (plain ? 0u : HEADER_BYTES);

    memset(pixels, 0, MSV2_PACKED_SLOT_BYTES);
    if (size == 0)
        return MSV2_PACKED_MISSING;
    if (size > PLAIN_BEATS)
        return MSV2_PACKED_SIZE;
    for (n = 0; n < BLOCK_GROUPS && !plain; n++)
        used += code_at(slot, n) == ALL_PLANES ? PLANES : code_at(slot, n);
    if (!plain && (HEADER_BYTES + used + BEAT_BYTES - 1u) / BEAT_BYTES != size)
        return MSV2_PACKED_LENGTH;
    for (n = 0; n < BLOCK_GROUPS; n++) { /* row by row, in a row half by half, in a half channel by channel */
        planes = plain || code_at(slot, n) == ALL_PLANES ? PLANES : code_at(slot, n);
        group_into(pixels + n / CHANNELS * CHANNELS * GROUP + n % CHANNELS, at, planes);
        at += planes;
    }
    if (!plain)
        memcpy(pixels, slot, CHANNELS);
    add_up(pixels);
    return check_of(slot, BEAT_BYTES * size, number) == entry >> SIZE_BITS ? MSV2_PACKED_NONE : MSV2_PACKED_CHECK;
}

enum msv2_packed_result msv2_unpack_frame(const uint8_t *bytes, uint32_t size, uint32_t width, uint32_t height, uint8_t *pixels,
                                          struct msv2_packed_damage *damage)
{
    struct msv2_packed_damage found = {0, 0, 0, 0, MSV2_PACKED_NONE};
    const uint32_t needed = msv2_packed_bytes(width, height), columns = (width + TILE - 1u) / TILE;
    const uint32_t blocks = columns * ((height + TILE - 1u) / TILE) * MSV2_PACKED_BLOCKS;
    const uint8_t *table = bytes + (size_t)MSV2_PACKED_SLOT_BYTES * blocks;
    uint8_t block[MSV2_PACKED_SLOT_BYTES];
    uint32_t n, row;

    if (damage)
        *damage = found;
    if (needed == 0 || size < needed)
        return MSV2_PACKED_CUT_OFF;
    for (n = 0; n < blocks; n++) {
        uint32_t x = n / MSV2_PACKED_BLOCKS % columns * TILE, entry = (uint32_t)table[2u * n] | (uint32_t)table[2u * n + 1u] << 8;
        uint32_t y = n / MSV2_PACKED_BLOCKS / columns * TILE + n % MSV2_PACKED_BLOCKS * MSV2_PACKED_BLOCK_HEIGHT;
        uint32_t wide = width - x < MSV2_PACKED_BLOCK_WIDTH ? width - x : MSV2_PACKED_BLOCK_WIDTH;
        enum msv2_packed_error error = entry ? MSV2_PACKED_SIZE : MSV2_PACKED_NONE;

        if (y < height)
            error = msv2_unpack_block(bytes + (size_t)MSV2_PACKED_SLOT_BYTES * n, entry, n, block);
        if (error != MSV2_PACKED_NONE && found.blocks++ == 0) {
            found.block = n;
            found.x = x;
            found.y = y;
            found.error = error;
        }
        for (row = 0; row < MSV2_PACKED_BLOCK_HEIGHT && y + row < height; row++)
            memcpy(pixels + CHANNELS * ((size_t)(y + row) * width + x), block + CHANNELS * MSV2_PACKED_BLOCK_WIDTH * row,
                   CHANNELS * (size_t)wide);
    }
    if (damage)
        *damage = found;
    return found.blocks ? MSV2_PACKED_DAMAGED : MSV2_PACKED_WHOLE;
}
