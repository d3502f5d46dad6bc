/* Unpacks packed frames of the MSV2 accelerator, in portable C99: no heap, no floating point, no system calls.
 *
 *     if (msv2_unpack_frame(bytes, size, width, height, pixels, &damage) == MSV2_PACKED_WHOLE)
 *         pixels has width * height * 4 bytes: red, green, blue, coverage; rows without gaps
 *     else
 *         damage.error says what is wrong with block damage.block, the first one that is damaged
 *
 * spec/packed.py has the format.
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef MSV2_PACKED_H
#define MSV2_PACKED_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define MSV2_PACKED_BLOCK_WIDTH 16u
#define MSV2_PACKED_BLOCK_HEIGHT 4u
#define MSV2_PACKED_BLOCKS 4u       /* blocks of a tile, from top to bottom */
#define MSV2_PACKED_SLOT_BYTES 256u /* bytes of a block's slot, and of its pixels */

/* What is wrong with a block. */
enum msv2_packed_error {
    MSV2_PACKED_NONE = 0,    /* nothing */
    MSV2_PACKED_MISSING = 1, /* it was never written */
    MSV2_PACKED_SIZE = 2,    /* its size is impossible */
    MSV2_PACKED_LENGTH = 3,  /* the codes of its groups do not add up to its size */
    MSV2_PACKED_CHECK = 4    /* its beats are not those that were packed */
};

enum msv2_packed_result {
    MSV2_PACKED_WHOLE = 0,   /* every block is right */
    MSV2_PACKED_DAMAGED = 1, /* at least one block is damaged */
    MSV2_PACKED_CUT_OFF = 2  /* there are fewer bytes than the frame has, or it has no pixels: nothing was unpacked */
};

/* The damage of a frame. */
struct msv2_packed_damage {
    uint32_t blocks;              /* number of damaged blocks */
    uint32_t block;               /* number of the first of them; 0 where there is none */
    uint32_t x, y;                /* column and row of that block's first pixel */
    enum msv2_packed_error error; /* what is wrong with it */
};

/* Bytes of a packed frame in memory, with the blocks' slots and the table. 0 where they do not fit 32 bits. */
uint32_t msv2_packed_bytes(uint32_t width, uint32_t height);

/* Unpacks one block into 4 rows of 16 pixels of 4 bytes. `slot` has the block's MSV2_PACKED_SLOT_BYTES bytes, `entry` is its
   number in the table, which is not of a block beyond the frame. With MSV2_PACKED_CHECK the pixels are what the bytes say, with
   the other errors they are 0. */
enum msv2_packed_error msv2_unpack_block(const uint8_t *slot, uint32_t entry, uint32_t number, uint8_t *pixels);

/* Unpacks a frame of `size` bytes into width * height pixels of 4 bytes. Pixels of damaged blocks are as above. `damage` may be
   null. */
enum msv2_packed_result msv2_unpack_frame(const uint8_t *bytes, uint32_t size, uint32_t width, uint32_t height, uint8_t *pixels,
                                          struct msv2_packed_damage *damage);

#ifdef __cplusplus
}
#endif

#endif
