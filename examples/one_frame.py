"""One frame of the embedded scene in 20 lines: the golden renderer, the machine's RTL, and every bit compared.

    python examples/one_frame.py [SIZE]    the first run builds a simulator, which takes minutes
"""

import sys
from pathlib import Path

from golden.msv2_ref.pipeline import render
from golden.scenes.embedded.splats import cached_embedded_model
from golden.scenes.embedded.views import embedded_cameras
from golden.scenes.pictures import save_png
from spec.config import TINY
from spec.private import private_folder
from tb.frame.whole import picture, simulate_machine
from tb.top.device import machine
from tb.top.memory import MemorySpeed

size = int(sys.argv[1]) if len(sys.argv) > 1 else 64
frame = render(cached_embedded_model(), embedded_cameras(size, size)[0], config=TINY)
with private_folder(Path("build/examples/one_frame")) as out:  # another run at the same time gets a folder of its own
    numbers, pixels = simulate_machine(frame, machine(TINY), out / "sim", beta=None, speed=MemorySpeed())
    save_png(out / "frame.png", picture(frame, pixels))
print(f"{numbers['entries']} intersections, {numbers['cycles']} cycles, "
      f"{'equal in every bit' if numbers['bit_exact'] else 'NOT equal'}")
sys.exit(not numbers["bit_exact"])
