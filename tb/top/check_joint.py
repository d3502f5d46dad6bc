"""Compares the machine's joint frames of two eyes (`spec.joint`) with the golden renderer's."""

from __future__ import annotations

import numpy as np

from golden.host.memory_image import DisplayPixels, memory_image, spill_beats
from golden.msv2_ref.frame_memory import display_pixels, frame_pixels
from golden.msv2_ref.joint import SOURCE, TARGET, JointFrame
from golden.msv2_ref.joint_batches import JointBatches
from golden.msv2_ref.saturations import count_saturated, frame_saturations_of
from golden.msv2_ref.supertiles import list_counts
from spec.memory import page_beats
from tb.frame.bound import joint_ops
from tb.top.check import differences, wrong_counters
from tb.top.expected import expected_joint
from tb.top.memory import MemorySpeed
from tb.top.player import FrameResult, FrameRun
