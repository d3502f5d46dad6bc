"""Stimuli of the projection unit in joint frames (`spec.joint`): the points of `tb.culling.projection_stimuli` for two eyes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from golden.host.joint_registers import JointRegisters
from golden.msv2_ref.joint import project_eyes
from golden.msv2_ref.projection import FAINT, NEAR, VISIBLE, Projected, projected_splats
from golden.msv2_ref.saturations import misplaced
from spec.config import AcceleratorConfig
from spec.formats import Fixed, SmallFloat
from spec.joint import EYES, grid_origins
from spec.memory import frame_settings
from spec.records import Record
from tb.culling.projection_stimuli import SETTINGS, Case

JOINT_SETTINGS = (*SETTINGS, "joint", "shift", "target_position")


@dataclass(frozen=True)
class JointCase:
    """A case in a machine with joint frames.

    Attributes:
        base: the points, and the registers of the source.
        offset: (3,) how far the target's camera is from the source's, in world units; None for frames of one eye.
        shift: the distance of the eyes' grids.
        rendering: whether the points come in the second phase, in which nothing is dropped or counted.
    """

    base: Case
    offset: np.ndarray | None
    shift: int = 0
    rendering: bool = False

    @property
    def config(self) -> AcceleratorConfig:
        """The machine."""
        return self.base.config

    @property
    def joint(self) -> bool:
        """Whether the frames are of two eyes."""
        return self.offset is not None

    @property
    def name(self) -> str:
        """The case's name, for messages."""
        kind = f"shift {self.shift}" if self.joint else "one eye"
        return f"{self.base.name}, {kind}{', second phase' * self.rendering}"

    @property
    def registers(self) -> JointRegisters:
        """The registers of both eyes, which are the same in frames of one eye."""
        source = self.base.registers
        move = np.zeros(3) if self.offset is None else self.offset
        target = replace(source, position=self.config.formats.view.round(source.position + move))
        return JointRegisters(source, target, self.shift)

    def projected(self, frame: int) -> list[Projected]:
        """What the golden renderer finds of a frame's points, for each of its eyes."""
        return list(project_eyes(self.config, self.base.frames[frame], self.registers))[: EYES if self.joint else 1]

    @property
    def points(self) -> int:
        """Items of all frames at the unit's operators."""
        return self.base.points * (EYES if self.joint else 1)

    @property
    def items(self) -> np.ndarray:
        """The GaussianPoint items of all frames."""
        return self.base.items

    @property
    def splats(self) -> np.ndarray:
        """The splats of all frames."""
        return np.concatenate([self._splats(number) for number in range(len(self.base.frames))])

    def _splats(self, frame: int) -> np.ndarray:
        words, both = self.base.frames[frame], self.projected(frame)
        found = []
        for eye, (r, projected) in enumerate(zip(self.registers.eyes, both, strict=False)):
            rows = projected_splats(self.config, words, r, projected)[:-1]
            rows["eye"] = eye
            for name in ("first_x", "last_x"):
                rows[name] += grid_origins(self.shift)[eye] if self.joint else 0
            if self.rendering:  # `JointProjectionBench` sets what means nothing to 0
                every = np.zeros(len(words.geometry), rows.dtype)
                every["index"], every["eye"], every["none"] = np.arange(len(every)), eye, 1
                every[rows["index"]] = rows
                rows = every
            found.append(rows)
        rows, end = np.concatenate(found), np.zeros(1, found[0].dtype)
        end["end"] = 1
        return np.concatenate([rows[np.lexsort((rows["eye"], rows["index"]))], end])

    @property
    def observed(self) -> dict[str, int]:
        """The counters after the last frame, by `spec.joint`."""
        if self.rendering:
            return {}
        both = self.projected(-1)
        reason = both[0].reason
        seen = np.logical_or.reduce([eye.reason == VISIBLE for eye in both])
        culled = {name: int((reason == code).sum()) for name, code in (("culled_near", NEAR), ("culled_faint", FAINT))}
        outside = int((~seen & (reason != NEAR) & (reason != FAINT)).sum())
        return {**culled, "culled_outside": outside, "saturated_means": sum(int(misplaced(eye).sum()) for eye in both)}

    @property
    def settings(self) -> dict[str, int]:
        """Bit patterns of the unit's settings."""
        fields = {f.name: f for f in frame_settings(self.config).fields}
        more = {"joint": self.joint, "shift": self.shift, "target_position": self.registers.target.position}
        found = {**self.base.settings, "rendering": int(self.rendering)}
        for name, value in more.items():
            number = fields[name].format
            raw = number.quantise(np.ravel(value)).tolist() if isinstance(number, SmallFloat) else [int(value)]
            assert isinstance(number, Fixed | SmallFloat)
            found[name] = Record(name, "", (fields[name],)).pack({name: raw})
        return found
