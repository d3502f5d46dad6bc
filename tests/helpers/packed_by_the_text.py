"""Packs one block as the text of `spec.packed` says, bit by bit, with Python's integers."""

from __future__ import annotations

from collections.abc import Sequence

from spec.packed import CHECK_BITS, CHECK_POLYNOMIAL, CHECK_START


def signed(value: int) -> int:
    """A byte as two's complement."""
    return value - 256 if value > 127 else value


def check_by_the_text(data: bytes, number: int) -> int:
    """The check of a block's beats."""
    state, top = number % (1 << CHECK_BITS) ^ CHECK_START, 1 << CHECK_BITS - 1
    for byte in data:
        for bit in range(8):
            leaves = bool(state & top) != bool(byte >> bit & 1)
            state = state * 2 % (1 << CHECK_BITS) ^ (CHECK_POLYNOMIAL if leaves else 0)
    return state


def block_by_the_text(pixels: Sequence[Sequence[Sequence[int] | None]], number: int) -> tuple[bytes, int]:
    """(bytes of a block, its check) of 4 rows of 16 pixels (r, g, b, coverage); None is a pixel beyond the frame."""
    channels = [[None if pixel is None else ((pixel[0] - pixel[1]) % 256, pixel[1], (pixel[2] - pixel[1]) % 256, pixel[3])
                 for pixel in row] for row in pixels]
    if channels[0][0] is None:
        return b"", 0

    def value(x: int, y: int, k: int) -> int:
        return channels[y][x][k] if x >= 0 and y >= 0 else 0

    def difference(x: int, y: int, k: int) -> int:
        if channels[y][x] is None:
            return 0
        return (value(x, y, k) - value(x - 1, y, k) - value(x, y - 1, k) + value(x - 1, y - 1, k)) % 256

    def stored(plain: bool) -> tuple[list[int], bytes]:
        codes, planes = [], b""
        for y in range(4):
            for group in range(8):
                half, k = divmod(group, 4)
                values = [difference(8 * half + i, y, k) for i in range(8)]
                if not plain and (half, y) == (0, 0):
                    values[0] = 0
                fitting = [n for n in range(7) if all(
                    (-(1 << n - 1) <= signed(v) < 1 << n - 1) if n else v == 0 for v in values)]
                codes.append(fitting[0] if fitting else 7)
                count = 8 if plain or not fitting else fitting[0]
                planes += bytes(sum((values[i] >> j & 1) << i for i in range(8)) for j in range(count))
        return codes, planes

    codes, planes = stored(plain=False)
    head = sum(value(0, 0, k) << 8 * k for k in range(4)) | sum(code << 32 + 3 * n for n, code in enumerate(codes))
    data = head.to_bytes(16, "little") + planes
    data += bytes(-len(data) % 32)
    if len(data) >= 256:
        data = stored(plain=True)[1]
    return data, check_by_the_text(data, number)
