/* SPDX-License-Identifier: Apache-2.0 */
#ifndef DEMO_H
#define DEMO_H

#include "msv2_driver.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Renders a frame image at byte address `dram`, and prints the machine and its counters. Returns 0, or a result's number. */
int demo(void *port, const uint8_t *bytes, uint32_t size, uint32_t dram, uint32_t timeout);

#ifdef __cplusplus
}
#endif

#endif
