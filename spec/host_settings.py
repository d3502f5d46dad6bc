"""The numbers of a frame's settings as the host writes them, and what a machine checks of them before it begins."""

from __future__ import annotations

from dataclasses import dataclass

from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS, MAX_SH_DEGREE, SUPER_X
from spec.memory import SHIFT_BITS, frame_settings
from spec.records import Field


@dataclass(frozen=True)
class Setting:
    """One number of the frame's settings: `field[index]`, or the field itself where it has only one; `number` counts those of
    a machine that has them all."""

    field: Field
    index: int
    number: int

    @property
    def name(self) -> str:
        """Name of its register: the field's name, with the index where the field has several numbers."""
        return f"{self.field.name}_{self.index}" if self.field.count > 1 else self.field.name


@dataclass(frozen=True)
class Limit:
    """The limits low..high of a setting's bit pattern, read as an unsigned number. Where `low` is larger than `high`, they are
    those of a signed number: patterns from `low` on and up to `high` are legal.

    Attributes:
        setting: name of the setting.
        low, high: least and largest legal pattern, or those of the smallest and of the largest legal number.
        words: the limits in words, for readers.
        where: name of a setting of one bit; the limits apply only where that setting is 1. If empty, they always apply.
    """

    setting: str
    low: int
    high: int
    words: str
    where: str = ""

    def allows(self, pattern: int) -> bool:
        """Whether a bit pattern is legal."""
        if self.low > self.high:
            return pattern >= self.low or pattern <= self.high
        return self.low <= pattern <= self.high


def with_every_register(config: AcceleratorConfig) -> tuple[AcceleratorConfig, ...]:
    """Machines that together have the registers of all machines with the same number formats: one with chunks and stereo, one
    with lists by super-tile, packed frames and overlapped phases, one with joint frames, and one whose joint frames may have a
    warped target. Registers that a later one has and no earlier one have the higher addresses; the last ones lack what an
    earlier one has already."""
    chunked = config.with_(lockstep=False, stereo=False, streams=1, lists="tile", order="spatial", chunks=True, packed=False,
                           joint=False, overlap=False)
    supertiles = chunked.with_(stereo=False, records="compact", lists="supertile", bank_memories=False)
    return (chunked.with_(depth=True, stereo=True), supertiles.with_(packed=True, overlap=True), supertiles.with_(joint=True),
            supertiles.with_(joint=True, depth=True, stereo=True))


def settings(config: AcceleratorConfig) -> tuple[Setting, ...]:
    """Every number of the frame's settings; the register of setting `number` lies at SETTINGS_BASE + 4 * number. A setting has
    the same number in all machines that have it."""
    own = {f.name for f in frame_settings(config).fields}
    every = {f.name: f for machine in with_every_register(config) for f in frame_settings(machine).fields}
    numbers = [(f, i) for f in every.values() for i in range(f.count)]
    found = tuple(Setting(f, i, number) for number, (f, i) in enumerate(numbers) if f.name in own)
    for setting in found:
        if setting.field.format.width > 32:
            raise ValueError(f"{setting.name} must fit a register of 32 bits, not {setting.field.format.width!r}")
    return found


def limits(config: AcceleratorConfig) -> tuple[Limit, ...]:
    """What the machine checks before a frame, in the order of the settings; all other settings may have any value.

    The machine does not check whether regions of memory overlap or end beyond the address space: that is the host's task.
    """
    view, top = config.formats.view, 1 << (config.formats.view.width - 1)
    least, shift = 1 << (view.sig_bits - 1), (MAX_LEVELS - 1).bit_length()
    return (
        Limit("near", least, top - 1, "positive"),
        Limit("depth_scale", 0, top - 1, "not negative"),
        Limit("width", 1, config.row_width, "1..row_width"),
        Limit("height", 1, config.row_width, "1..row_width"),
        *([Limit("sh_degree", 0, config.sh_degree, f"0..{config.sh_degree}")] if config.sh_degree < MAX_SH_DEGREE else []),
        *([] if config.supertiles else [Limit("view_shift", 0, shift, f"0..{shift}")]),
        *(Limit("display", 1, 1, f"1 where `{name}` is", where=name) for name in ("stereo", "packed") if getattr(config, name)),
        *([Limit("shift", (1 << SHIFT_BITS) - SUPER_X, SUPER_X, f"-{SUPER_X}..{SUPER_X}, where `joint` is 1", where="joint")]
          if config.joint else []),
        *([Limit("joint", 1, 1, "1 where `stereo` is", where="stereo")] if config.warps_joint else []),
    )


def first_illegal(config: AcceleratorConfig, patterns: dict[str, int]) -> int | None:
    """Number of the first setting that is out of its limits, or None if all are legal; `patterns` holds bit patterns by
    register name."""
    numbers = {setting.name: setting.number for setting in settings(config)}
    holding = [limit for limit in limits(config) if not limit.where or patterns[limit.where]]
    return min((numbers[limit.setting] for limit in holding if not limit.allows(patterns[limit.setting])), default=None)
