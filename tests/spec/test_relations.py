"""What the parameters of a machine must agree on: named machines pass, each relation is refused when broken alone."""

from __future__ import annotations

from dataclasses import fields, replace

import pytest

from spec.config import MACHINES, PAPER, NumberFormats
from spec.formats import SQ, UQ, SmallFloat
from spec.relations import EXACT_INT_BITS, LEAST_INT_BITS, check_relations, problems


def changed(**formats: object):
    return PAPER.with_(formats=replace(PAPER.formats, **formats))


@pytest.mark.parametrize("config", MACHINES.values(), ids=lambda config: config.name)
def test_named_machines_have_no_problems(config):
    for stereo in {False, not (config.supertiles or config.lockstep)}:
        for depth in {True, stereo}:
            check_relations(config.with_(stereo=stereo, depth=depth, fine_depth=depth))


@pytest.mark.parametrize(("formats", "message"), [
    ({"colour": SQ(1, 9)}, "formats.colour must be of the kind of UQ1.9, not SQ1.9"),
    ({"view": UQ(1, 9)}, None),
    ({"exp2_segments": 3}, "formats.exp2_segments must be one of 1, 2, 4, 8, 16, not 3"),
    ({"accumulator": UQ(0, 14)}, "formats.accumulator must have at least the integer bits of colour, 1, not UQ0.14"),
    ({"depth_key": UQ(22, 2)}, "formats.depth_key must have no fraction bits, not UQ22.2"),
    ({"depth_key": UQ(20, 0)}, "formats.depth_key must have at least 21 bits, four octaves of view's ulps"),
    ({"conic": SmallFloat(16, 6, 62)}, "formats.conic must have 0 as its largest exponent, so a bias of 63, not float16e6b62"),
    ({"factor": SQ(1, 14)}, "formats.factor must have the fraction bits of conic's significand, 15, not SQ1.14"),
    ({"mean2d": SQ(19, 12)}, "formats.mean2d must have at most 29 bits beside conic float16e6b63, not SQ19.12"),
    ({"offset": SQ(5, 25)}, "formats.offset must have at most 24 fraction bits, those of mean2d times conic, not SQ5.25"),
    ({"cut": SQ(3, 11)}, "formats.cut must have the fraction bits of log2_opacity, 10, not SQ3.11"),
    ({"cut": SQ(3, 14), "log2_opacity": SQ(4, 14)}, "formats.cut must have fewer fraction bits than exponent, 14, not SQ3.14"),
    ({"offset": SQ(5, 13)}, "formats.exponent must not have more fraction bits than offset SQ5.13, not SQ11.14"),
    ({"slope": SQ(7, 13)}, "formats.slope must have the fraction bits of exponent, 14, not SQ7.13"),
    ({"curvature": SQ(3, 15)}, "formats.curvature must have the fraction bits of exponent, 14, not SQ3.15"),
    ({"exponent": SQ(18, 14)}, "formats.exponent must have at most 32 bits, not SQ18.14"),
    ({"weight": UQ(0, 16)}, "formats.weight must not have more fraction bits than transmittance UQ0.15, not UQ0.16"),
    ({"cut": SQ(3, 4), "log2_opacity": SQ(4, 4)}, "formats.cut must have a fraction bit below the 16 segments"),
    ({"alpha": UQ(1, 17), "transmittance": UQ(0, 12)}, "formats.alpha must have at most 16 fraction bits, not UQ1.17"),
    ({"plane": SQ(6, 6)}, "formats.plane must have at least 7 fraction bits, not SQ6.6"),
    ({"accumulator": UQ(1, 22)}, "formats.accumulator must have at most the 21 fraction bits of a weight times a value"),
    ({"depth": UQ(0, 20)}, "a weight UQ0.12 times a value UQ0.20 must fit 31 bits for depth_accumulator, not 32"),
    ({"transmittance": UQ(0, 19)}, "formats.transmittance must have at most 18 bits beside alpha UQ1.12, not UQ0.19"),
    ({"sh_basis": SQ(0, 9)}, "formats.sh_basis must have at least the 10 fraction bits of the table of roots, not SQ0.9"),
    ({"sh_rest": SQ(1, 37)}, "formats.sh_basis and formats.sh_rest must have at most 49 fraction bits together, not 50"),
    ({"sh_dc": SQ(2, 24)}, "formats.sh_dc must have at most the 23 fraction bits of sh_basis and sh_rest, not SQ2.24"),
    ({"colour": UQ(1, 24), "accumulator": UQ(1, 14)}, "formats.colour must have at most the 23 fraction bits"),
    ({"quaternion": SQ(0, 20)}, "GaussianGeometry must fit 256 bits, not "),
    ({"colour": UQ(1, 15)}, "SplatRecord must fit 256 bits, not "),
    ({"plane": SQ(8, 12)}, "TileSetting must fit 64 bits, not "),
    ({"depth_key": UQ(27, 0)}, "Intersection must fit 64 bits, not "),
    ({"sh_dc": SQ(2, 19)}, "formats.sh_dc must leave the base colours of all levels 256 bits, not SQ2.19"),
    ({"accumulator": UQ(1, 16)}, "formats.accumulator must fit the 16 bits of a FramePixel's colour, not UQ1.16"),
    ({"transmittance": UQ(0, 17)}, "formats.transmittance must fit the 16 bits of a FramePixel's transmittance, not UQ0.17"),
])
def test_each_relation_is_refused_when_broken(formats, message):
    if message is None:  # a kind that the constructor itself cannot compare
        with pytest.raises(AttributeError):
            changed(**formats)
        return
    config = changed(**formats)
    assert any(problem.startswith(message) for problem in problems(config)), problems(config)
    with pytest.raises(ValueError):
        check_relations(config)


@pytest.mark.parametrize("name", [*EXACT_INT_BITS, *LEAST_INT_BITS])
def test_integer_bits_that_were_derived(name):
    usual = getattr(PAPER.formats, name)
    for bits in (usual.int_bits - 1, usual.int_bits + 1):
        if bits < 0:
            continue
        found = problems(changed(**{name: replace(usual, int_bits=bits)}))
        refused = any(problem.startswith(f"formats.{name} must have ") and "integer bits" in problem for problem in found)
        assert refused == (name in EXACT_INT_BITS or bits < usual.int_bits), found


def test_every_fixed_point_format_can_still_be_shortened_or_lengthened():
    """The relations leave room: shorter colours, keys and transmittances are what the presets are made of."""
    for formats in ({"colour": UQ(1, 8)}, {"transmittance": UQ(0, 13)}, {"depth_key": UQ(21, 0)}, {"exp2_segments": 4},
                    {"sh_basis": SQ(0, 12)}, {"work": SmallFloat(14, 8, 127)}, {"plane": SQ(6, 10)}, {"exponent": SQ(12, 14)},
                    {"conic": SmallFloat(15, 6, 63), "factor": SQ(1, 14)}, {"blend_weight": UQ(1, 7)}):
        check_relations(changed(**formats))
    assert set(EXACT_INT_BITS) | set(LEAST_INT_BITS) < {f.name for f in fields(NumberFormats)}
