/* A driver of the MSV2 accelerator in portable C99, for bare metal or a kernel; no heap, no floating point.
 *
 * A frame takes four calls:
 *
 *     struct msv2_machine machine;
 *     struct msv2_image image;
 *     if (msv2_probe(port, &machine) == MSV2_OK &&                        is there a machine, and which one?
 *         msv2_image_open(&image, bytes, size) == MSV2_OK &&              a file that frame_image.py has written
 *         msv2_load(port, &machine, &image, dram) == MSV2_OK &&           the model and the tiles, into memory
 *         msv2_render(port, &image, dram, timeout, &failure) == MSV2_OK)  settings, start, interrupt
 *         the frame is in memory at dram + image.frame
 *
 * The port is yours: four functions below, which msv2_driver.c calls and does not define.
 * Registers: msv2_registers.h, which `msv2 docs` and `msv2 verilog` write; docs/registers.md and docs/machine.md explain them.
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef MSV2_DRIVER_H
#define MSV2_DRIVER_H

#include <stdint.h>

#include "msv2_registers.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What the port gives. `port` is passed through unseen: a base address, a structure of yours, or a null pointer. */

/* Reads and writes the register at a byte offset from the machine's base, in 32 bits. Accesses happen in the order of the
   calls, so registers must be mapped as a device, without a cache. */
uint32_t msv2_read(void *port, uint32_t offset);
void msv2_write(void *port, uint32_t offset, uint32_t value);

/* Copies bytes to a byte address of the memory that the machine sees, in any way: a loop, memcpy or a DMA engine. The machine
   must see them after the return: flush the cache where the machine does not snoop it. */
void msv2_store(void *port, uint32_t address, const uint8_t *bytes, uint32_t count);

/* Waits until the machine's interrupt line is high, or for at most `timeout` milliseconds. Returns 1 for the interrupt, 0 for
   the timeout. A polling port reads MSV2_INTERRUPT until it is not 0. */
int msv2_wait(void *port, uint32_t timeout);

enum msv2_result {
    MSV2_OK = 0,
    MSV2_NO_MACHINE = 1,    /* the ID register holds something else */
    MSV2_OTHER_VERSION = 2, /* the register map has another major version than msv2_registers.h */
    MSV2_BAD_IMAGE = 3,     /* the bytes are no frame image, or are cut off */
    MSV2_OTHER_MACHINE = 4, /* the image was made for a machine with other parameters or number formats */
    MSV2_BAD_ADDRESS = 5,   /* dram is not a multiple of 32, or the image does not fit below 4 GiB */
    MSV2_BUSY = 6,          /* a frame is under way */
    MSV2_TIMEOUT = 7,       /* no interrupt in time: the frame was aborted */
    MSV2_FRAME_FAILED = 8,  /* the machine ended the frame early; struct msv2_failure says why */
    MSV2_OTHER_IMAGE = 9,   /* the bytes are a frame image of another version of the file format */
    MSV2_OTHER_FORMAT = 10  /* the image's Gaussians are not in the record format that the machine reads */
};

/* Formats in which Gaussians lie in memory. */
enum msv2_records {
    MSV2_RECORDS_WIDE = 0,   /* wide records */
    MSV2_RECORDS_CHUNKS = 1, /* wide records in chunks */
    MSV2_RECORDS_COMPACT = 2 /* compact records in chunks */
};

/* What the machine says of itself. */
struct msv2_machine {
    uint32_t version_major, version_minor;
    uint32_t fingerprint; /* differs where machines differ in any parameter or number format */
    uint32_t cores_x, cores_y;
    uint32_t levels;    /* levels of foveation */
    uint32_t row_width; /* widest frame in pixels */
    int stereo;         /* whether it renders frames of two eyes */
    int chunks;         /* whether it reads Gaussians in chunks */
    int compact;        /* whether it reads compact records */
    int counters;       /* whether it has counters; without them all counts are 0 */
    int supertiles;     /* whether its lists belong to super-tiles */
    int packed;         /* whether it can pack frames */
};

/* A frame image in memory. It points into the bytes given to msv2_image_open, which must stay where they are. */
struct msv2_image {
    const uint8_t *settings, *segments, *bytes;
    uint32_t setting_count, segment_count;
    uint32_t records; /* enum msv2_records */
    uint32_t fingerprint;
    uint32_t width, height;
    uint32_t pixel_bytes; /* 0: the frame is packed, and msv2_unpack_frame (msv2_packed.h) gives its pixels */
    uint32_t frame;  /* where the pixels will be, in bytes from the start of the image in memory; rows without gaps */
    uint32_t memory; /* bytes of memory that the frame needs from there on */
    uint32_t target; /* of a frame of two eyes: where the second eye's pixels will be, as `frame`; 0: the frame has one eye */
};

/* Why a frame ended early. */
struct msv2_failure {
    enum msv2_error error;
    uint32_t bad_setting;   /* with MSV2_ERROR_BAD_SETTING: the offset of the register that is out of its limits */
    uint32_t error_clients; /* with a read or write error: the clients, as in MSV2_ERROR_CLIENTS */
};

/* Counters of all frames since msv2_clear_counters. */
struct msv2_counters {
    uint64_t cycles, cycles_table, cycles_geometry, cycles_render;
    uint32_t frames, read_beats, write_beats;
    uint32_t points, survivors, intersections, groups, ops, pixels;
    uint32_t fetch_hits, fetch_misses; /* of splat records or, with super-tiles, of chunk headers */
};

/* Reads what the machine is. MSV2_OK, MSV2_NO_MACHINE or MSV2_OTHER_VERSION. */
enum msv2_result msv2_probe(void *port, struct msv2_machine *machine);

/* Checks the bytes of a frame image and finds its parts. MSV2_OK, MSV2_BAD_IMAGE or MSV2_OTHER_IMAGE. */
enum msv2_result msv2_image_open(struct msv2_image *image, const uint8_t *bytes, uint32_t size);

/* Copies the model, the tiles and whatever else the host provides to byte address `dram` on. They stay for further frames:
   only changed parts need another copy. MSV2_OK, MSV2_OTHER_FORMAT, MSV2_OTHER_MACHINE, MSV2_BAD_ADDRESS, or MSV2_BUSY. */
enum msv2_result msv2_load(void *port, const struct msv2_machine *machine, const struct msv2_image *image, uint32_t dram);

/* Writes all settings of a frame whose image lies at `dram`. The machine copies them when it starts. */
void msv2_set_frame(void *port, const struct msv2_image *image, uint32_t dram);

/* Starts a frame with the present settings and returns at once. MSV2_OK or MSV2_BUSY. */
enum msv2_result msv2_start(void *port);

/* Waits for the end of the frame that msv2_start has begun, and acknowledges the interrupt. MSV2_OK, MSV2_TIMEOUT, or
   MSV2_FRAME_FAILED with the reason in `failure`, which may be null. */
enum msv2_result msv2_finish(void *port, uint32_t timeout, struct msv2_failure *failure);

/* msv2_set_frame, msv2_start and msv2_finish. */
enum msv2_result msv2_render(void *port, const struct msv2_image *image, uint32_t dram, uint32_t timeout,
                             struct msv2_failure *failure);

/* Sets all counters to 0. */
void msv2_clear_counters(void *port);

/* Reads a counter of 64 bits at the offset of its lower register, such as MSV2_CYCLES_TOTAL_LOW. */
uint64_t msv2_count64(void *port, uint32_t low);

/* Reads the counters. */
void msv2_read_counters(void *port, struct msv2_counters *counters);

#ifdef __cplusplus
}
#endif

#endif
