"""The embedded scene's objects: a furnished room with a window onto hills. Lengths are metres; x is east, y north, z up."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from golden.scenes.embedded import textures as tx
from golden.scenes.embedded.raytrace import BALL, BOX, DISC, RECT, TUBE, World

HALF = 2.3
"""Half the room's edge in metres: the floor is 4.6 m square."""
HEIGHT = 2.6
"""Height of the ceiling in metres."""
WINDOW = (0.95, 0.68)
"""Half width and half height of the window in the middle of the north wall, in metres."""
CENTRE = np.array([0.0, 0.0, 0.5 * HEIGHT])
"""The middle of the room."""

X, Y, Z = np.eye(3)

# name: (pattern, colour a, colour b, period in metres, mirror F0, Phong shine, emission)
MATERIALS = {
    "floor": (tx.PLANKS, (0.62, 0.42, 0.26), (0.42, 0.26, 0.15), (0.42, 0.19), 0.0, 0.0, 0.0),
    "brick": (tx.BRICK, (0.66, 0.31, 0.22), (0.74, 0.70, 0.64), (0.20, 0.165), 0.0, 0.0, 0.0),
    "stripes": (tx.STRIPES, (0.83, 0.79, 0.66), (0.43, 0.58, 0.53), (0.32, 1.0), 0.0, 0.0, 0.0),
    "plaster": (tx.MOTTLE, (0.90, 0.87, 0.80), (0.84, 0.80, 0.73), (0.35, 0.35), 0.0, 0.0, 0.0),
    "ceiling": (tx.PLAIN, (0.93, 0.92, 0.90), (0, 0, 0), (1.0, 1.0), 0.0, 0.0, 0.0),
    "white": (tx.PLAIN, (0.93, 0.93, 0.91), (0, 0, 0), (1.0, 1.0), 0.0, 0.0, 0.0),
    "rug": (tx.RUG, (0.63, 0.16, 0.17), (0.16, 0.20, 0.36), (1.25, 1.25), 0.0, 0.0, 0.0),
    "table": (tx.PLANKS, (0.78, 0.56, 0.33), (0.62, 0.40, 0.21), (0.5, 0.12), 0.0, 0.0, 0.0),
    "dark_wood": (tx.PLANKS, (0.40, 0.25, 0.16), (0.30, 0.18, 0.11), (0.5, 0.10), 0.0, 0.0, 0.0),
    "leg": (tx.PLAIN, (0.36, 0.22, 0.14), (0, 0, 0), (1.0, 1.0), 0.0, 0.0, 0.0),
    "chair": (tx.PLAIN, (0.80, 0.24, 0.14), (0, 0, 0), (1.0, 1.0), 0.0, 0.0, 0.0),
    "wire": (tx.PLAIN, (0.16, 0.17, 0.19), (0, 0, 0), (1.0, 1.0), 0.0, 0.0, 0.0),
    "books": (tx.BOOKS, (0.45, 0.30, 0.18), (0.10, 0.07, 0.05), (0.075, 0.10), 0.0, 0.0, 0.0),
    "poster": (tx.TEXT, (0.95, 0.94, 0.90), (0.12, 0.13, 0.18), (0.085, 0.115), 0.0, 0.0, 0.0),
    "star": (tx.STAR, (0.97, 0.96, 0.93), (0.09, 0.10, 0.14), (0.28, 0.28), 0.0, 0.0, 0.0),
    "cube": (tx.CHECKER, (0.85, 0.66, 0.18), (0.16, 0.27, 0.50), (0.11, 0.11), 0.0, 0.0, 0.0),
    "mirror_ball": (tx.PLAIN, (0.20, 0.23, 0.28), (0, 0, 0), (1.0, 1.0), 0.55, 0.5, 0.0),
    "glaze": (tx.STRIPES, (0.16, 0.42, 0.62), (0.85, 0.88, 0.88), (1.0, 0.13), 0.05, 0.35, 0.0),
    "pot": (tx.PLAIN, (0.72, 0.37, 0.22), (0, 0, 0), (1.0, 1.0), 0.0, 0.0, 0.0),
    "leaf": (tx.STRIPES, (0.13, 0.31, 0.12), (0.23, 0.42, 0.18), (0.05, 1.0), 0.0, 0.0, 0.0),
    "shade": (tx.PLAIN, (0.98, 0.86, 0.58), (0, 0, 0), (1.0, 1.0), 0.0, 0.0, 0.75),
    "bulb": (tx.PLAIN, (1.0, 0.97, 0.86), (0, 0, 0), (1.0, 1.0), 0.0, 0.0, 1.0),
    "near_hill": (tx.MOTTLE, (0.24, 0.42, 0.17), (0.47, 0.60, 0.27), (3.0, 3.0), 0.0, 0.0, 1.0),
    "mid_hill": (tx.MOTTLE, (0.33, 0.50, 0.36), (0.49, 0.62, 0.44), (7.0, 7.0), 0.0, 0.0, 1.0),
    "far_hill": (tx.MOTTLE, (0.49, 0.60, 0.69), (0.58, 0.68, 0.75), (16.0, 16.0), 0.0, 0.0, 1.0),
}


class _Builder:
    """Collects primitives, group by group, and packs them into a `World`."""

    def __init__(self) -> None:
        self.groups: list[list[tuple[int, np.ndarray, np.ndarray, tuple[float, float], int]]] = []

    def group(self) -> None:
        """Starts a group of primitives: those added next share one bounding sphere."""
        self.groups.append([])

    def add(self, shape: int, material: str, origin, x, y, z, param: tuple[float, float] = (0.0, 0.0)) -> None:
        """A unit shape whose local axes x, y, z become the given vectors in metres at `origin`."""
        axes = np.column_stack([x, y, z]).astype(float)
        self.groups[-1].append((shape, axes, np.asarray(origin, float), param, list(MATERIALS).index(material)))

    def rect(self, material: str, origin, x, y, hole: tuple[float, float] = (0.0, 0.0)) -> None:
        """A parallelogram of half edges x and y, with a centred hole given in shares of them."""
        self.add(RECT, material, origin, x, y, np.cross(x, y) / np.linalg.norm(np.cross(x, y)), hole)

    def disc(self, material: str, origin, x, y) -> None:
        """An ellipse of half axes x and y."""
        self.add(DISC, material, origin, x, y, np.cross(x, y) / np.linalg.norm(np.cross(x, y)))

    def ball(self, material: str, origin, radii) -> None:
        """An axis-aligned ellipsoid."""
        self.add(BALL, material, origin, *np.diag(np.broadcast_to(radii, 3)))

    def box(self, material: str, origin, half, yaw: float = 0.0) -> None:
        """A box of half edges `half`, turned by `yaw` degrees about the vertical."""
        c, s = math.cos(math.radians(yaw)), math.sin(math.radians(yaw))
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        self.add(BOX, material, origin, *(turn * np.asarray(half, float)).T)

    def tube(self, material: str, start, end, radius: float, end_radius: float | None = None) -> None:
        """An open round tube or cone frustum between two points."""
        start, end = np.asarray(start, float), np.asarray(end, float)
        axis = end - start
        side = np.cross(axis, X if abs(axis[0]) < 0.9 * np.linalg.norm(axis) else Y)
        side *= radius / np.linalg.norm(side)
        other = np.cross(axis, side) / np.linalg.norm(axis)
        self.add(TUBE, material, start, side, other, axis, ((end_radius or radius) / radius, 0.0))

    def world(self, lights: tuple[np.ndarray, np.ndarray, np.ndarray]) -> World:
        """Packs the primitives; `lights` are the lights' sample points, their axes and their colours."""
        flat = [primitive for group in self.groups for primitive in group]
        shapes, axes, origins, params, materials = zip(*flat, strict=True)
        inverse = np.linalg.inv(np.array(axes))
        to_local = np.concatenate([inverse, -inverse @ np.array(origins)[:, :, None]], axis=2)
        ends = np.cumsum([len(group) for group in self.groups])
        pattern, a, b, texel, mirror, shine, emission = zip(*MATERIALS.values(), strict=True)
        sun = np.array([0.42, 1.0, 0.62])
        return World(
            np.array(shapes), np.ascontiguousarray(to_local), np.linalg.norm(np.array(axes), axis=1), np.array(params),
            np.array(materials), np.column_stack([ends - [len(g) for g in self.groups], ends]),
            np.array([_bound(group) for group in self.groups]), np.array(pattern),
            np.array([a, b], float).transpose(1, 0, 2).copy(), np.array(texel), np.array(mirror), np.array(shine),
            np.array(emission), *lights, np.array([sun / np.linalg.norm(sun), (0.70, 0.63, 0.48)]),
            np.array([(0.42, 0.38, 0.34), (0.46, 0.46, 0.46)]),
        )


def _bound(group: list) -> np.ndarray:
    """Centre and radius of a sphere around the corners of the boxes that hold a group's primitives."""
    corners = []
    for shape, axes, origin, param, _ in group:
        wide = max(1.0, param[0]) if shape == TUBE else 1.0
        low = {TUBE: 0.0, RECT: 0.0, DISC: 0.0}.get(shape, -1.0)
        high = 0.0 if shape in (RECT, DISC) else 1.0
        box = np.array([(i, j, k) for i in (-wide, wide) for j in (-wide, wide) for k in (low, high)])
        corners.append(box @ axes.T + origin)
    points = np.concatenate(corners)
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return np.append(centre, np.linalg.norm(points - centre, axis=1).max() * (1 + 1e-9))


def _room(b: _Builder) -> None:
    # Floor, ceiling and walls extend 6 cm past the corners, where no camera sees them, so that splats cover the seams.
    half, mid, over = HALF * np.eye(3), 0.5 * HEIGHT * Z, 1.0 + 0.06 / HALF
    x, y, z = over * half[0], over * half[1], over * mid
    b.group()
    b.rect("floor", 0 * Z, x, y)
    b.rect("ceiling", HEIGHT * Z, x, y)
    b.rect("brick", mid - half[0], y, z)
    b.rect("stripes", mid + half[0], y, z)
    b.rect("plaster", mid - half[1], x, z)
    b.rect("plaster", mid + half[1], x, z, (WINDOW[0] / HALF / over, WINDOW[1] / (0.5 * HEIGHT) / over))


def _window(b: _Builder) -> None:
    b.group()
    (w, h), c = WINDOW, CENTRE + (HALF + 0.03) * Y
    for side in (-1, 1):
        b.box("white", c + side * w * X, (0.045, 0.07, h + 0.045))
        b.box("white", c + side * h * Z, (w, 0.07, 0.045))
        b.box("white", c + side * w / 3 * X, (0.016, 0.02, h))
    b.box("white", c, (w, 0.02, 0.016))
    b.box("white", c - (h + 0.06) * Z - 0.10 * Y, (w + 0.12, 0.10, 0.02))


def _on_walls(b: _Builder) -> None:
    b.group()
    b.rect("poster", (-0.7, -HALF + 0.01, 1.5), -0.38 * X, 0.5 * Z)
    b.box("dark_wood", (1.1, -HALF + 0.02, 1.02), (0.42, 0.03, 1.02))
    b.ball("wire", (0.78, -HALF + 0.09, 1.0), 0.035)
    b.group()
    b.rect("star", (-HALF + 0.01, 0.35, 1.62), 0.36 * Y, 0.36 * Z)
    b.group()
    b.box("books", (HALF - 0.13, 0.75, 1.0), (0.13, 0.65, 1.0))


def _table(b: _Builder) -> None:
    b.group()
    b.disc("rug", (0, 0.05, 0.004), 1.25 * X, 1.25 * Y)
    b.group()
    b.disc("table", (0, 0.2, 0.74), 0.62 * X, 0.62 * Y)
    b.disc("table", (0, 0.2, 0.70), 0.62 * X, 0.62 * Y)
    b.tube("dark_wood", (0, 0.2, 0.70), (0, 0.2, 0.74), 0.62)
    for angle in np.radians((30, 150, 270)):
        out = np.array([math.cos(angle), math.sin(angle), 0])
        b.tube("leg", 0.2 * Y + 0.45 * out, 0.2 * Y + 0.30 * out + 0.70 * Z, 0.022)
    b.group()
    b.ball("mirror_ball", (0.19, 0.0, 0.74 + 0.17), 0.17)
    b.box("cube", (-0.36, 0.02, 0.74 + 0.11), (0.11, 0.11, 0.11), 25)


def _plant(b: _Builder) -> None:
    """A glazed vase with arching leaves; each leaf is two ellipses on a bent stem."""
    foot = np.array([-0.10, 0.46, 0.74])
    b.group()
    b.tube("glaze", foot, foot + 0.16 * Z, 0.06, 0.105)
    b.tube("glaze", foot + 0.16 * Z, foot + 0.26 * Z, 0.105, 0.055)
    b.group()
    for k in range(14):
        angle, rise = 2.399963 * k, 0.16 + 0.024 * k  # the golden angle spreads the leaves
        out = np.array([math.cos(angle), math.sin(angle), 0])
        knee = foot + 0.26 * Z + 0.10 * out + rise * Z
        b.tube("leaf", foot + 0.24 * Z, knee, 0.006, 0.004)
        along = 0.62 * out + (0.62 - 0.05 * k) * Z
        along *= 0.10 / np.linalg.norm(along)
        side = np.cross(Z, out)
        b.disc("leaf", knee + along, 0.032 * side, along)
        b.disc("leaf", knee + 2.0 * along + 0.06 * out - 0.02 * Z, 0.026 * side, 0.075 * out - 0.035 * Z)


def _chair(b: _Builder, at: np.ndarray, yaw: float) -> None:
    c, s = math.cos(math.radians(yaw)), math.sin(math.radians(yaw))
    x, y = np.array([c, s, 0]), np.array([-s, c, 0])
    b.group()
    b.box("chair", at + 0.44 * Z, (0.20, 0.20, 0.018), yaw)
    for i in (-1, 1):
        b.tube("leg", at + 0.19 * (i * x - y), at + 0.17 * (i * x - y) + 0.44 * Z, 0.014)
        b.tube("leg", at + 0.19 * (i * x + y), at + 0.18 * i * x + 0.22 * y + 0.95 * Z, 0.015)
    for i in range(5):
        rail = at + 0.19 * y + 0.075 * (i - 2) * x
        b.tube("wire", rail + 0.45 * Z, rail + 0.025 * y + 0.86 * Z, 0.006)
    b.box("chair", at + 0.215 * y + 0.90 * Z, (0.20, 0.012, 0.045), yaw)


def _lattice(b: _Builder) -> None:
    """A wire trellis in a thin frame; its 6 mm wires are about a pixel wide at 256x256."""
    foot, x, w, h = np.array([1.22, 0.62, 0.0]), np.array([0.78, -0.62, 0.0]), 0.40, 1.45
    x /= np.linalg.norm(x)
    b.group()
    for i in (-1, 1):
        b.tube("leg", foot + i * w * x, foot + i * w * x + h * Z, 0.016)
    for i in range(1, 8):
        at = foot + (2 * i / 8 - 1) * w * x
        b.tube("wire", at + 0.15 * Z, at + h * Z, 0.003)
    for k in range(14):
        at = foot + (0.15 + 0.1 * k) * Z
        b.tube("wire", at - w * x, at + w * x, 0.003)


def _rest(b: _Builder) -> None:
    b.group()
    b.box("cube", (-1.35, 1.35, 0.24), (0.24, 0.24, 0.24), 12)
    b.box("table", (-1.33, 1.37, 0.58), (0.15, 0.15, 0.10), 40)
    b.group()
    b.tube("pot", (1.75, -0.35, 0.0), (1.75, -0.35, 0.34), 0.13, 0.19)
    b.disc("floor", (1.75, -0.35, 0.31), 0.18 * X, 0.18 * Y)
    for k in range(11):
        angle = 2.399963 * k
        out = np.array([math.cos(angle), math.sin(angle), 0])
        along = 0.07 * out + (0.22 + 0.008 * k) * Z
        b.disc("leaf", np.array([1.75, -0.35, 0.32]) + along + 0.03 * out, 0.03 * np.cross(Z, out), along)
    b.group()
    b.tube("wire", (0, 0.2, HEIGHT), (0, 0.2, 2.16), 0.008)
    b.tube("shade", (0, 0.2, 2.16), (0, 0.2, 1.96), 0.05, 0.21)
    b.ball("bulb", (0, 0.2, 2.05), 0.045)


def _outside(b: _Builder) -> None:
    b.group()
    b.rect("near_hill", (0, 62.4, -3.0), 60 * X, 60 * Y)
    b.group()
    b.ball("near_hill", (-13, 34, -4), (16, 9, 6.6))
    b.ball("near_hill", (12, 30, -4), (11, 7, 5.2))
    b.group()
    b.ball("mid_hill", (9, 62, -6), (30, 14, 11.5))
    b.ball("mid_hill", (-34, 70, -6), (30, 14, 12.5))
    b.group()
    b.ball("far_hill", (-20, 150, -10), (62, 20, 29))
    b.ball("far_hill", (48, 160, -10), (60, 20, 33))


def _lights() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Three samples of the lamp and four of the window: enough for soft-looking shadows, and the same for every ray."""
    lamp = [np.array([0.09 * math.cos(a), 0.2 + 0.09 * math.sin(a), 1.95]) for a in np.radians((90, 210, 330))]
    pane = [CENTRE + np.array([0.45 * i, HALF - 0.12, 0.34 * k]) for i in (-1, 1) for k in (-1, 1)]
    axes = [-Z] * len(lamp) + [-Y] * len(pane)
    colours = [(0.42, 0.36, 0.27)] * len(lamp) + [(0.62, 0.66, 0.70)] * len(pane)
    return np.array(lamp + pane), np.array(axes, float), np.array(colours)


@cache
def embedded_world() -> World:
    """The embedded scene for the ray tracer."""
    b = _Builder()
    _room(b)
    _window(b)
    _on_walls(b)
    _table(b)
    _plant(b)
    _chair(b, np.array([-0.95, -0.35, 0.0]), 62)
    _lattice(b)
    _rest(b)
    _outside(b)
    return b.world(_lights())
