/* Where the processor begins: at address 0, with nothing set but its stack pointer. SPDX-License-Identifier: Apache-2.0 */
    .section .start, "ax"
    .globl start
start:
    la sp, stack_top
    la a0, bss_begin
    la a1, bss_end
1:  bgeu a0, a1, 2f
    sw zero, 0(a0)
    addi a0, a0, 4
    j 1b
2:  call main
3:  j 3b
