/* A program that uses the driver: one frame, with what the machine says of itself and of the frame.
 * SPDX-License-Identifier: Apache-2.0
 */
#include "demo.h"

#include <inttypes.h>
#include <stdio.h>

static int failed(const char *what, enum msv2_result result)
{
    printf("%s: result %d\n", what, (int)result);
    return (int)result;
}

int demo(void *port, const uint8_t *bytes, uint32_t size, uint32_t dram, uint32_t timeout)
{
    struct msv2_machine machine;
    struct msv2_image image;
    struct msv2_failure failure = {MSV2_ERROR_NONE, 0, 0};
    struct msv2_counters counted;
    enum msv2_result result;

    if ((result = msv2_probe(port, &machine)) != MSV2_OK)
        return failed("probe", result);
    printf("machine %" PRIu32 ".%" PRIu32 ": %" PRIu32 "x%" PRIu32 " cores, %" PRIu32 " levels, rows of %" PRIu32 " pixels\n",
           machine.version_major, machine.version_minor, machine.cores_x, machine.cores_y, machine.levels, machine.row_width);
    if ((result = msv2_image_open(&image, bytes, size)) != MSV2_OK)
        return failed("image", result);
    if ((result = msv2_load(port, &machine, &image, dram)) != MSV2_OK)
        return failed("load", result);
    msv2_clear_counters(port);
    result = msv2_render(port, &image, dram, timeout, &failure);
    if (result == MSV2_FRAME_FAILED)
        printf("the frame failed: error %d, setting 0x%03" PRIX32 ", clients 0x%08" PRIX32 "\n", (int)failure.error,
               failure.bad_setting, failure.error_clients);
    if (result != MSV2_OK)
        return failed("render", result);
    msv2_read_counters(port, &counted);
    printf("cycles %" PRIu64 " table %" PRIu64 " geometry %" PRIu64 " render %" PRIu64 "\n", counted.cycles,
           counted.cycles_table, counted.cycles_geometry, counted.cycles_render);
    printf("frames %" PRIu32 " points %" PRIu32 " survivors %" PRIu32 " entries %" PRIu32 " groups %" PRIu32 " pixels %" PRIu32
           " read_beats %" PRIu32 " write_beats %" PRIu32 " %s_hits %" PRIu32 " %s_misses %" PRIu32 "\n",
           counted.frames, counted.points, counted.survivors, counted.intersections, counted.groups, counted.pixels,
           counted.read_beats, counted.write_beats, machine.supertiles ? "header" : "fetch", counted.fetch_hits,
           machine.supertiles ? "header" : "fetch", counted.fetch_misses);
    return 0;
}
