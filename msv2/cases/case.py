"""What a hard case is: shots that any renderer can take, and what must be seen in them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from golden.scenes.camera import Camera
from golden.scenes.gaze import Display, FoveationMap, foveation_map, no_foveation
from golden.scenes.model import GaussianModel
from spec.config import DEFAULT
from spec.constants import MAX_LEVELS

COLUMNS = ("oracle", "golden", "gradient", "rtl")
"""Who takes part: the float64 renderer, the integer one, the differentiable one, the hardware."""

RIM = 2.8 / 255
"""An alpha of 1 on the rim of a support of 3 sigma: two renderers may differ by it in a pixel that the rim meets."""


class CaseFailure(AssertionError):
    """What a case expected and did not see, in words."""


def require(holds: object, message: str) -> None:
    """CaseFailure unless `holds`."""
    if not holds:
        raise CaseFailure(message)


def close(what: str, got: ArrayLike, wanted: ArrayLike, within: float) -> float:
    """The largest difference; CaseFailure where it is above `within`, or where something is not finite."""
    got, wanted = np.asarray(got, float), np.asarray(wanted, float)
    got, wanted = np.broadcast_arrays(got, wanted)
    off = np.abs(got - wanted)
    if np.isfinite(off).all() and off.max(initial=0.0) <= within:
        return float(off.max(initial=0.0))
    worst = np.unravel_index(np.where(np.isfinite(off), off, np.inf).argmax(), off.shape)
    where = f" at {list(map(int, worst))}" if worst else ""
    raise CaseFailure(f"{what} must be within {within:.3g} of {wanted[worst]:.6g}, not {got[worst]:.6g}{where}")


@dataclass(frozen=True)
class Renderer:
    """How exact a renderer is.

    Attributes:
        name: one of COLUMNS.
        error: largest error of a colour in 0..1 or of a coverage, away from rims of footprints.
        ulp: relative step of a camera-space depth.
        depth: largest relative error of a pixel's depth.
        largest_colour: colours above are cut there.
        weights: blend tiles weigh their levels by each pixel's `exact` eccentricity, or by the tile's `plane`.
    """

    name: str
    error: float
    ulp: float
    depth: float
    largest_colour: float = math.inf
    weights: str = "plane"


_N = DEFAULT.formats
ORACLE = Renderer("oracle", 1e-9, 2.0**-52, 1e-9)
GOLDEN = Renderer("golden", 0.5 / 255, 2.0 ** (1 - _N.view.sig_bits), 2e-3, _N.colour.to_float(_N.colour.raw_max))
GRADIENT = Renderer("gradient", 2e-5, 2.0**-23, 1e-5, weights="exact")
RENDERERS = {renderer.name: renderer for renderer in (ORACLE, GOLDEN, GRADIENT)}


@dataclass(frozen=True)
class Shot:
    """A frame that a case asks for.

    Attributes:
        model, camera: what is seen, from where.
        gaze: in pixels: the model's levels are used; None: level 1 everywhere, or level 2 where `outer`.
        outer: level 2 everywhere, where alpha may reach 1; the model needs two levels.
        background: red, green, blue.
        beta, obb: as the integer renderer takes them.
        rim: bound of the difference between two renderers in any pixel; None: they are not compared.
        empty: nothing is covered, and that is what is asked; where it is not said, a frame without coverage fails.
    """

    model: GaussianModel
    camera: Camera
    gaze: tuple[float, float] | None = None
    outer: bool = False
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    beta: int | None = None
    obb: bool = False
    rim: float | None = RIM
    empty: bool = False

    @property
    def foveation(self) -> FoveationMap:
        """What every tile shows."""
        display = Display(self.camera.width, self.camera.height)
        if self.gaze is not None:
            return foveation_map(display, self.gaze, min(self.model.levels, MAX_LEVELS))
        plain = no_foveation(display)
        return replace(plain, levels=2, tile_level=np.ones_like(plain.tile_level)) if self.outer else plain


@dataclass(frozen=True)
class Seen:
    """What a renderer made of a shot.

    Attributes:
        image: (H, W, 3) float64, not clamped.
        coverage: (H, W) float64, 1 - T; None where a renderer does not tell.
        depth: (H, W) float64 world units, NaN where it is invalid; None likewise.
        near, faint: culled at the near plane and for their opacity; None likewise.
        drawn: splats on some tile's list; None likewise.
        entries: pairs of splat and tile.
        tile_entries: (tiles,) int64; None likewise.
        frame: what the renderer returned.
    """

    image: np.ndarray
    coverage: np.ndarray | None
    depth: np.ndarray | None
    near: int | None
    faint: int | None
    drawn: int | None
    entries: int | None
    tile_entries: np.ndarray | None
    frame: object = None

    def counts(self, **wanted: int) -> None:
        """CaseFailure where a count that the renderer tells is another."""
        for name, value in wanted.items():
            got = getattr(self, name)
            require(got is None or got == value, f"{name} must be {value}, not {got}")

    def at(self, x: int, y: int) -> float:
        """Coverage of a pixel."""
        return float(self.coverage[y, x])


Shots = Mapping[str, Shot]
Album = Mapping[str, Seen]


FIELDS = ("sh_dc", "opacity", "means", "log_scales", "quats")
"""Fields whose gradients are compared."""

SMOOTH = ("sh_dc", "opacity", "log_scales")
"""Of these, those that no depth hangs on."""


@dataclass(frozen=True)
class Gradients:
    """What a case expects of gradients of the shot named `shot`, besides that all are finite and the oracle's.

    Attributes:
        shot: which one.
        zero: rows whose every gradient is exactly 0.
        lit: rows whose colour has a gradient other than 0.
        moved: rows whose position has one.
        compared: fields whose directional derivatives are those of the oracle by finite differences. Not those along which an
            order, a cut or the near plane changes within the step.
    """

    shot: str
    zero: tuple[int, ...] = ()
    lit: tuple[int, ...] = ()
    moved: tuple[int, ...] = ()
    compared: tuple[str, ...] = FIELDS


@dataclass(frozen=True)
class Case:
    """A hard case.

    Attributes:
        number: that of the list in docs/stability.md.
        name: what it is called in tests and on command lines.
        what: what it is.
        expected: what must come of it.
        shots: the frames of a renderer; None for cases about something else.
        expect: raises CaseFailure where the frames are not as they must be.
        gradients: what is asked of the differentiable renderer; empty: the case is not for it.
        columns: of the renderers that take the shots.
        checks: by column: whatever else is run; gives the worst error or None.
        absent: by column: why the case has no part there.
        rtl: the integer renderer's frames are played through the machine.
        eyes: frames of two eyes by name (`msv2.cases.eyes.TwoEyes`), which the machine plays; None for cases without.
    """

    number: int
    name: str
    what: str
    expected: str
    shots: Callable[[Renderer], Shots] | None = None
    expect: Callable[[Album, Renderer, Shots], None] | None = None
    gradients: tuple[Gradients, ...] = ()
    columns: tuple[str, ...] = ("oracle", "golden", "gradient")
    checks: Mapping[str, Callable[[], float | None]] = field(default_factory=dict)
    absent: Mapping[str, str] = field(default_factory=dict)
    rtl: bool = True
    eyes: Callable[[], Mapping[str, Any]] | None = None

    @property
    def id(self) -> str:
        """Number and name."""
        return f"{self.number:02d}-{self.name}"


def scene_case(number: int, name: str, what: str, expected: str, **options: object) -> Callable[[Callable], Case]:
    """Turns `expect(album, renderer, shots)` into a case; `options` are Case's."""
    def made(expect: Callable[[Album, Renderer, Shots], None]) -> Case:
        return Case(number, name, what, expected, expect=expect, **options)
    return made
