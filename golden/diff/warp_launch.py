"""Runs Warp kernels on torch's tensors: in the same memory, on the same device and in the same stream."""

from __future__ import annotations

import torch
import warp as wp

wp.config.log_level = wp.LOG_WARNING  # no banner and no message for each compiled module
wp.init()

BLOCK = 256
"""Threads of a block on a GPU: one for each pixel of a tile. On the CPU, a block is one thread."""

_SCALARS = {int: wp.int32, float: wp.float32}


def array(tensor: torch.Tensor, dtype: object) -> wp.array:
    """A contiguous tensor as a Warp array of `dtype`. `int` and `float` stand for 32 bits; vectors lie along the last axis."""
    if not tensor.numel():  # torch takes every empty tensor to be contiguous, but Warp does not
        tensor = torch.empty(tensor.shape, dtype=tensor.dtype, device=tensor.device)
    return wp.from_torch(tensor.detach(), dtype=_SCALARS.get(dtype, dtype), requires_grad=False)


def launch(kernel: object, threads: int, device: torch.device, *args: object) -> None:
    """Runs `kernel` on `threads` threads, after the work that torch has queued on the device and before what it queues next."""
    if threads == 0:
        return
    stream = wp.stream_from_torch(torch.cuda.current_stream(device)) if device.type == "cuda" else None
    wp.launch(kernel, dim=threads, inputs=list(args), device=wp.device_from_torch(device), stream=stream, block_dim=BLOCK)
