/* The driver that msv2_driver.h describes.
 * SPDX-License-Identifier: Apache-2.0
 */
#include "msv2_driver.h"

#include <stddef.h>

/* A frame image, in little-endian words of 32 bits (spec/images.py describes it, frame_image.py writes it):
 *
 *     word  0  magic               6  width in pixels     settings   offset of the register and its value, for each
 *           1  version             7  height in pixels    segments   address, bytes, and where they begin in the file, for each
 *           2  record format       8  bytes of a pixel    contents         (0 where the frame is packed)
 *           3  fingerprint         9  address of the frame
 *           4  settings           10  bytes of memory
 *           5  segments
 */
#define IMAGE_MAGIC 0x3249534Du /* "MSI2" */
#define IMAGE_VERSION 3u
#define IMAGE_WORDS 11u
#define SETTING_BYTES 8u
#define SEGMENT_BYTES 12u
#define BEAT_BYTES 32u

#define ENABLES (MSV2_CONTROL_ENABLE_DONE_MASK | MSV2_CONTROL_ENABLE_ERROR_MASK)
#define CAUSES (MSV2_INTERRUPT_DONE_MASK | MSV2_INTERRUPT_ERROR_MASK)

/* Settings that hold addresses in beats. Images are made for memory that begins at 0. */
static const uint32_t bases[] = {
    MSV2_GEOMETRY_BASE, MSV2_COLOUR_BASE, MSV2_TILES_BASE, MSV2_VIEWS_BASE, MSV2_DIRECTORY_BASE,
    MSV2_ENTRIES_BASE, MSV2_SPILL_BASE, MSV2_FRAME_BASE, MSV2_CHUNKS_BASE, MSV2_TARGET_TILES_BASE,
    MSV2_TARGET_FRAME_BASE, MSV2_SUPERTILES_BASE,
};

static uint32_t word_at(const uint8_t *bytes, uint32_t number)
{
    const uint8_t *at = bytes + 4u * (size_t)number;
    return (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

/* The value of the setting at an offset; 0 where the image has none. */
static uint32_t setting_of(const struct msv2_image *image, uint32_t offset)
{
    uint32_t number;

    for (number = 0; number < image->setting_count; number++)
        if (word_at(image->settings, 2u * number) == offset)
            return word_at(image->settings, 2u * number + 1u);
    return 0;
}

static uint32_t part(uint32_t value, uint32_t mask, uint32_t shift)
{
    return (value & mask) >> shift;
}

enum msv2_result msv2_probe(void *port, struct msv2_machine *machine)
{
    uint32_t version, array;

    if (msv2_read(port, MSV2_ID) != MSV2_MAGIC)
        return MSV2_NO_MACHINE;
    version = msv2_read(port, MSV2_VERSION);
    machine->version_major = part(version, MSV2_VERSION_MAJOR_MASK, MSV2_VERSION_MAJOR_SHIFT);
    machine->version_minor = part(version, MSV2_VERSION_MINOR_MASK, MSV2_VERSION_MINOR_SHIFT);
    if (machine->version_major != MSV2_VERSION_MAJOR_EXPECTED)
        return MSV2_OTHER_VERSION;
    array = msv2_read(port, MSV2_MACHINE_ARRAY);
    machine->fingerprint = msv2_read(port, MSV2_FINGERPRINT);
    machine->cores_x = part(array, MSV2_MACHINE_ARRAY_CORES_X_MASK, MSV2_MACHINE_ARRAY_CORES_X_SHIFT);
    machine->cores_y = part(array, MSV2_MACHINE_ARRAY_CORES_Y_MASK, MSV2_MACHINE_ARRAY_CORES_Y_SHIFT);
    machine->levels = part(array, MSV2_MACHINE_ARRAY_LEVELS_MASK, MSV2_MACHINE_ARRAY_LEVELS_SHIFT);
    machine->stereo = (array & MSV2_MACHINE_ARRAY_STEREO_MASK) != 0;
    machine->chunks = (array & MSV2_MACHINE_ARRAY_CHUNKS_MASK) != 0;
    machine->compact = (array & MSV2_MACHINE_ARRAY_COMPACT_MASK) != 0;
    machine->supertiles = (array & MSV2_MACHINE_ARRAY_SUPERTILES_MASK) != 0;
    machine->packed = (array & MSV2_MACHINE_ARRAY_PACKED_MASK) != 0;
    machine->counters = (array & MSV2_MACHINE_ARRAY_COUNTERS_MASK) != 0;
    machine->row_width = part(msv2_read(port, MSV2_MACHINE_FRAME), MSV2_MACHINE_FRAME_ROW_WIDTH_MASK,
                              MSV2_MACHINE_FRAME_ROW_WIDTH_SHIFT);
    return MSV2_OK;
}

enum msv2_result msv2_image_open(struct msv2_image *image, const uint8_t *bytes, uint32_t size)
{
    uint32_t left = size / 4u, number;

    if (left < 2u || word_at(bytes, 0) != IMAGE_MAGIC)
        return MSV2_BAD_IMAGE;
    if (word_at(bytes, 1) != IMAGE_VERSION)
        return MSV2_OTHER_IMAGE;
    if (left < IMAGE_WORDS)
        return MSV2_BAD_IMAGE;
    left -= IMAGE_WORDS;
    image->bytes = bytes;
    image->records = word_at(bytes, 2);
    image->fingerprint = word_at(bytes, 3);
    image->setting_count = word_at(bytes, 4);
    image->segment_count = word_at(bytes, 5);
    image->width = word_at(bytes, 6);
    image->height = word_at(bytes, 7);
    image->pixel_bytes = word_at(bytes, 8);
    image->frame = word_at(bytes, 9);
    image->memory = word_at(bytes, 10);
    if (image->setting_count < MSV2_SETTINGS_COUNT || left / (SETTING_BYTES / 4u) < image->setting_count)
        return MSV2_BAD_IMAGE;
    left -= SETTING_BYTES / 4u * image->setting_count;
    if (left / (SEGMENT_BYTES / 4u) < image->segment_count)
        return MSV2_BAD_IMAGE;
    image->settings = bytes + 4u * IMAGE_WORDS;
    image->segments = image->settings + SETTING_BYTES * (size_t)image->setting_count;
    for (number = 0; number < image->setting_count; number++) {
        uint32_t offset = word_at(image->settings, 2u * number);

        if (offset < MSV2_SETTINGS_BASE || offset >= MSV2_COUNTERS_BASE || offset % 4u != 0u)
            return MSV2_BAD_IMAGE;
    }
    for (number = 0; number < image->segment_count; number++) {
        uint32_t address = word_at(image->segments, 3u * number), count = word_at(image->segments, 3u * number + 1u);
        uint32_t place = word_at(image->segments, 3u * number + 2u);

        if (place > size || count > size - place || address > image->memory || count > image->memory - address)
            return MSV2_BAD_IMAGE;
    }
    image->target = 0;
    if (setting_of(image, MSV2_STEREO) || setting_of(image, MSV2_JOINT)) {
        uint32_t beat = setting_of(image, MSV2_TARGET_FRAME_BASE);

        if (beat >= image->memory / BEAT_BYTES)
            return MSV2_BAD_IMAGE;
        image->target = BEAT_BYTES * beat;
    }
    return MSV2_OK;
}

enum msv2_result msv2_load(void *port, const struct msv2_machine *machine, const struct msv2_image *image, uint32_t dram)
{
    uint32_t number, records = machine->compact ? MSV2_RECORDS_COMPACT : machine->chunks ? MSV2_RECORDS_CHUNKS : MSV2_RECORDS_WIDE;

    if (image->records != records)
        return MSV2_OTHER_FORMAT;
    if (image->fingerprint != machine->fingerprint)
        return MSV2_OTHER_MACHINE;
    if (dram % BEAT_BYTES != 0u || image->memory > UINT32_MAX - dram)
        return MSV2_BAD_ADDRESS;
    if (msv2_read(port, MSV2_STATUS) & MSV2_STATUS_BUSY_MASK)
        return MSV2_BUSY;
    for (number = 0; number < image->segment_count; number++)
        msv2_store(port, dram + word_at(image->segments, 3u * number),
                   image->bytes + word_at(image->segments, 3u * number + 2u), word_at(image->segments, 3u * number + 1u));
    return MSV2_OK;
}

void msv2_set_frame(void *port, const struct msv2_image *image, uint32_t dram)
{
    uint32_t number;
    size_t place;

    for (number = 0; number < image->setting_count; number++) {
        uint32_t offset = word_at(image->settings, 2u * number), value = word_at(image->settings, 2u * number + 1u);

        for (place = 0; place < sizeof bases / sizeof bases[0]; place++)
            if (offset == bases[place])
                value += dram / BEAT_BYTES;
        msv2_write(port, offset, value);
    }
}

enum msv2_result msv2_start(void *port)
{
    if (msv2_read(port, MSV2_STATUS) & MSV2_STATUS_BUSY_MASK)
        return MSV2_BUSY;
    /* A cause that is still pending would end the next wait at once. */
    msv2_write(port, MSV2_INTERRUPT, CAUSES);
    msv2_write(port, MSV2_CONTROL, ENABLES | MSV2_CONTROL_START_MASK);
    return MSV2_OK;
}

enum msv2_result msv2_finish(void *port, uint32_t timeout, struct msv2_failure *failure)
{
    int in_time = msv2_wait(port, timeout);
    uint32_t status, code;

    if (!in_time) {
        /* The machine first waits for the answers of memory that are under way, and then interrupts. */
        msv2_write(port, MSV2_CONTROL, ENABLES | MSV2_CONTROL_ABORT_MASK);
        (void)msv2_wait(port, timeout);
    }
    status = msv2_read(port, MSV2_STATUS);
    code = part(msv2_read(port, MSV2_ERROR), MSV2_ERROR_CODE_MASK, MSV2_ERROR_CODE_SHIFT);
    msv2_write(port, MSV2_INTERRUPT, CAUSES);
    if (failure != NULL) {
        failure->error = (enum msv2_error)code;
        failure->bad_setting = MSV2_SETTINGS_BASE + 4u * msv2_read(port, MSV2_BAD_SETTING);
        failure->error_clients = msv2_read(port, MSV2_ERROR_CLIENTS);
    }
    /* A frame that ended between the timeout and the abort is complete. */
    if (status & MSV2_STATUS_DONE_MASK)
        return MSV2_OK;
    return in_time ? MSV2_FRAME_FAILED : MSV2_TIMEOUT;
}

enum msv2_result msv2_render(void *port, const struct msv2_image *image, uint32_t dram, uint32_t timeout,
                             struct msv2_failure *failure)
{
    enum msv2_result result;

    msv2_set_frame(port, image, dram);
    result = msv2_start(port);
    return result == MSV2_OK ? msv2_finish(port, timeout, failure) : result;
}

void msv2_clear_counters(void *port)
{
    msv2_write(port, MSV2_CONTROL, ENABLES | MSV2_CONTROL_CLEAR_MASK);
}

uint64_t msv2_count64(void *port, uint32_t low)
{
    /* Reading the lower half keeps the upper half of the same cycle for the next read. */
    uint64_t value = msv2_read(port, low);

    return value | (uint64_t)msv2_read(port, low + 4u) << 32;
}

void msv2_read_counters(void *port, struct msv2_counters *counters)
{
    int supertiles = (msv2_read(port, MSV2_MACHINE_ARRAY) & MSV2_MACHINE_ARRAY_SUPERTILES_MASK) != 0;

    counters->cycles = msv2_count64(port, MSV2_CYCLES_TOTAL_LOW);
    counters->cycles_table = msv2_count64(port, MSV2_CYCLES_TABLE_LOW);
    counters->cycles_geometry = msv2_count64(port, MSV2_CYCLES_GEOMETRY_LOW);
    counters->cycles_render = msv2_count64(port, MSV2_CYCLES_RENDER_LOW);
    counters->frames = msv2_read(port, MSV2_FRAMES);
    counters->read_beats = msv2_read(port, MSV2_READ_BEATS);
    counters->write_beats = msv2_read(port, MSV2_WRITE_BEATS);
    counters->points = msv2_read(port, MSV2_POINTS);
    counters->survivors = msv2_read(port, MSV2_SURVIVORS);
    counters->intersections = msv2_read(port, MSV2_ENTRIES);
    counters->groups = msv2_read(port, MSV2_GROUPS);
    counters->ops = msv2_read(port, MSV2_OPS);
    counters->pixels = msv2_read(port, MSV2_PIXELS);
    counters->fetch_hits = msv2_read(port, supertiles ? MSV2_HEADER_HITS : MSV2_FETCH_HITS);
    counters->fetch_misses = msv2_read(port, supertiles ? MSV2_HEADER_MISSES : MSV2_FETCH_MISSES);
}
