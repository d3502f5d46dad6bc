"""The settings of the sweep: changes of one knob at a time from the default machine, and combinations of them. Frames of two
eyes are those of PAPER, as the default machine renders one.

ALPHA_MIN, the alpha below which a pixel skips a splat, and T_STOP, the transmittance below which a pixel stops, are not swept.
They are constants of the semantics (`spec.constants`) and no parameters of a machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace

from spec.config import MACHINES, PAPER, PRESETS, V3, AcceleratorConfig, NumberFormats
from spec.constants import MAX_LEVELS, REGION_START_DEG
from spec.formats import UQ

CONSTANTS = ("ALPHA_MIN", "T_STOP")
"""Thresholds that a machine cannot change."""

BASE = V3
"""The machine of one eye whose settings are varied."""

FIRST_BASE = PAPER
"""That of reports which do not name it."""

DEFAULT = "default"
PRESET = "preset"
"""Knobs with these names change nothing: they stand for BASE and for the presets in `spec.config`."""

BOTH_RENDERED = 180.0
"""A threshold in degrees beyond which no tile lies, so that nothing is warped."""


@dataclass(frozen=True)
class Setting:
    """A point of the sweep.

    Attributes:
        knob, value: the setting's name; for the default machine DEFAULT and "".
        config: the machine's configuration.
        sh_degree: the highest SH degree in use; None for the model's.
        levels: the number of levels, with the gaze in the middle of the frame; 1 for no foveation.
        obb: whether bounding boxes replace the exact tile test. The golden renderer and the cycle model can do so, the RTL
            cannot. threshold_deg: the threshold of a frame of two eyes; None for one eye. variant: the name of the model in
            use; "" for the scene's own. parts: (knob, value) of a combination's parts.
    """

    knob: str = DEFAULT
    value: str = ""
    config: AcceleratorConfig = field(default_factory=lambda: BASE)
    sh_degree: int | None = None
    levels: int = 1
    obb: bool = False
    threshold_deg: float | None = None
    variant: str = ""
    parts: tuple[tuple[str, str], ...] = ()

    @property
    def name(self) -> str:
        """The knob with its value."""
        return f"{self.knob} {self.value}".strip()

    @property
    def in_rtl(self) -> bool:
        """Whether the RTL supports the setting; it does not support bounding boxes."""
        return not self.obb

    @property
    def functions(self) -> int:
        """Number of basis functions up to the largest SH degree in use, without the first."""
        degree = self.config.sh_degree if self.sh_degree is None else min(self.sh_degree, self.config.sh_degree)
        return (degree + 1) ** 2 - 1


def word_bits(config: AcceleratorConfig) -> int:
    """The bits of all formats plus the number of segments. Of two equally fast machines, the smaller one has fewer."""
    return sum(value if isinstance(value, int) else value.width
               for value in (getattr(config.formats, f.name) for f in fields(NumberFormats)))


def _formats(setting: Setting, **changes: object) -> Setting:
    return replace(setting, config=setting.config.with_(formats=replace(setting.config.formats, **changes)))


def _work(setting: Setting, bits: int) -> Setting:
    """Changes the work format. Scales enter it without conversion, and an extent, a root, has at least half of its bits."""
    formats = setting.config.formats
    scale = replace(formats.scale, sig_bits=min(bits, formats.scale.sig_bits))
    extent = replace(formats.extent, sig_bits=max((bits + 1) // 2, formats.extent.sig_bits))
    return _formats(setting, work=replace(formats.work, sig_bits=bits), scale=scale, extent=extent)


def _conic(setting: Setting, bits: int) -> Setting:
    """Changes the conic format. The factor is the conic's significand. The formats on the exponent grid have no more fraction
    bits than it."""
    formats, fraction = setting.config.formats, bits - 1
    grid = {name: replace(getattr(formats, name), frac_bits=min(fraction, getattr(formats, name).frac_bits))
            for name in ("exponent", "slope", "curvature")}
    conic, factor = replace(formats.conic, sig_bits=bits), replace(formats.factor, frac_bits=fraction)
    return _formats(setting, conic=conic, factor=factor, **grid)


def _view(setting: Setting, bits: int) -> Setting:
    """Changes the view format. Inputs cannot have longer significands. The sort key counts ulps of the view format, in no more
    bits than an intersection has for it."""
    formats = setting.config.formats
    position = replace(formats.position, sig_bits=min(bits, formats.position.sig_bits))
    key = UQ(min(bits + 4, NumberFormats().depth_key.int_bits), 0)
    setting = _conic(_work(setting, min(bits, formats.work.sig_bits)), min(bits, formats.conic.sig_bits))
    return _formats(setting, view=replace(formats.view, sig_bits=bits), position=position, depth_key=key)


def _support(setting: Setting, sigma: float | None) -> Setting:
    return replace(setting, config=setting.config.with_(support_sigma=sigma))


Change = Callable[[Setting], Setting]

WORDS: dict[str, dict[str, Change]] = {
    "exponent segments": {str(n): lambda s, n=n: _formats(s, exp2_segments=n) for n in (2, 4, 8)},
    "transmittance bits": {str(n): lambda s, n=n: _formats(s, transmittance=UQ(0, n)) for n in (12, 13, 14, 16, 18)},
    "colour bits": {str(n + 1): lambda s, n=n: _formats(s, colour=UQ(1, n)) for n in (5, 6, 7, 8, 10, 11)},
    "depth key bits": {str(n): lambda s, n=n: _formats(s, depth_key=UQ(n, 0)) for n in (20, 21, 22, 23)},
    "view significand": {str(n): lambda s, n=n: _view(s, n) for n in (14, 16, 18, 22)},
    "work significand": {str(n): lambda s, n=n: _work(s, n) for n in (10, 12, 14, 16, 20)},
    "conic significand": {str(n): lambda s, n=n: _conic(s, n) for n in (12, 13, 14, 15, 18)},
}
"""Word lengths by knob, without those of the default."""


def changes(sh_degree: int, levels_named: str) -> dict[str, dict[str, Change]]:
    """All knobs of a machine for one eye, for a model of this SH degree."""
    return {
        "levels": {levels_named: lambda s: replace(s, levels=MAX_LEVELS)},
        "support radius": {name: lambda s, r=r: _support(s, r)
                           for name, r in (("2", 2.0), ("2.5", 2.5), ("3.5", 3.5), ("alpha's cut", None))},
        "SH degree": {str(d): lambda s, d=d: replace(s, sh_degree=d) for d in range(sh_degree)},
        "tile test": {"OBB": lambda s: replace(s, obb=True)},
        **WORDS,
    }


def applied(knob: str, value: str, change: Change, to: Setting | None = None) -> Setting:
    """A setting with one change from the default, or from another setting."""
    made = change(to or Setting())
    return replace(made, knob=knob, value=value, config=made.config.with_(name="tradeoff"))


def base_of(content: Mapping[str, object]) -> AcceleratorConfig:
    """The machine whose settings a report varied."""
    return MACHINES[str(content.get("config", FIRST_BASE.name))]


def preset_label(base: AcceleratorConfig, name: str) -> str:
    """What was measured for a preset: the machine itself, or the machine `base` with its formats and harmonics."""
    alike = PRESETS[name].with_(name=base.name, formats=base.formats, sh_degree=base.sh_degree) == base
    return f"`{name}`" if alike else f"`{base.name}` as `{name}`"


def single(
    sh_degree: int, levels_named: str, variants: Iterable[str], base: AcceleratorConfig = BASE,
) -> list[Setting]:
    """The default, the presets and every setting of each knob. Those of two eyes begin with both eyes rendered.

    `base` is the default machine; the presets have their formats and harmonics on it.
    """
    out = [Setting(config=base), *(
        Setting(PRESET, name, base.with_(name=name, formats=config.formats, sh_degree=config.sh_degree))
        for name, config in PRESETS.items())]
    for knob, settings in changes(sh_degree, levels_named).items():
        out += [applied(knob, value, change, out[0]) for value, change in settings.items()]
    stereo = PAPER.with_(stereo=True)
    eyes = [(BOTH_RENDERED, "both rendered"), *((float(t), f"{t:g} degrees") for t in reversed(REGION_START_DEG))]
    out += [Setting("ecc_thresh", name, stereo, threshold_deg=threshold) for threshold, name in eyes]
    return out + [Setting("variant", name, base, levels=MAX_LEVELS, variant=name) for name in variants]


def combined(
    name: str, parts: Iterable[tuple[str, str]], sh_degree: int, levels_named: str, base: AcceleratorConfig = BASE,
) -> Setting:
    """A setting that combines settings of several knobs."""
    known, made, parts = changes(sh_degree, levels_named), Setting(config=base), tuple(parts)
    for knob, value in parts:
        made = applied(knob, value, known[knob][value], made)
    return replace(made, knob="combination", value=name, parts=parts)
