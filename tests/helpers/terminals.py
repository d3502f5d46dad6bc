"""Commands on a pseudo-terminal, as a user at a screen starts them."""

from __future__ import annotations

import fcntl
import os
import pty
import struct
import subprocess
import termios

from spec.paths import ROOT


def on_a_terminal(*command: str, **options: object) -> tuple[int, str]:
    """Exit status of a command, and what it wrote to standard error, which is a terminal."""
    outer, inner = pty.openpty()
    fcntl.ioctl(inner, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 160, 0, 0))  # rows, columns
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=inner, **options) as process:
        os.close(inner)
        text = b""
        while True:
            try:
                piece = os.read(outer, 4096)
            except OSError:  # the last writer has closed the terminal
                break
            if not piece:
                break
            text += piece
    os.close(outer)
    return process.returncode, text.decode()
