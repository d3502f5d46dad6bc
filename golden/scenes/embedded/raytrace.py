"""A small deterministic ray tracer in numba: unit shapes under affine maps, hard shadows, one mirror bounce.

Every primitive is one of five unit shapes that an affine map brings to its place. A ray is transformed into the shape's own
frame without normalising its direction, so its parameter t is the same number in both frames. The float operations of
a ray depend on that ray alone: results are bit-identical from run to run and for any number of threads.

The tests of a ray against one shape are inlined into the loop over shapes, where numba then needs no reference counts of the
world's arrays: this halves the time of a picture.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import prange

from golden.kernels import compiled
from golden.scenes.embedded.textures import add, axpy, dot, normalise, scale, sky, texture

RECT, DISC, BALL, BOX, TUBE = range(5)
"""Unit shapes: |x|,|y| <= 1 with an optional hole; x^2+y^2 <= 1; the unit sphere; |x|,|y|,|z| <= 1; an open cone frustum
over 0 <= z <= 1 whose radius goes from 1 to `param[0]`."""

MISS = -1
"""Primitive index of a ray that reaches the sky."""

EPSILON = 1e-4
"""Distance in metres from the surface at which secondary rays start: far above float64's rounding error at 100 m, and far
below the thickness of a wire."""


class World(NamedTuple):
    """A scene as arrays. Primitives are sorted by group; P primitives, G groups, M materials, L light samples.

    Attributes:
        shape: (P,) int64, RECT..TUBE.
        to_local: (P, 3, 4) float64, world metres to the unit shape's frame.
        size: (P, 3) float64, metres per unit of each local axis: texture coordinates are in metres.
        param: (P, 2) float64, RECT: the hole's half extents in local units; TUBE: the end radius.
        material: (P,) int64.
        group: (G, 2) int64, first and one past the last primitive.
        bound: (G, 4) float64, a sphere around each group: centre and radius.
        pattern: (M,) int64, a texture of `golden.scenes.embedded.textures`.
        colours: (M, 2, 3) float64, the texture's two colours, in [0, 1].
        texel: (M, 2) float64, the texture's period in metres.
        mirror: (M,) float64, reflectance at normal incidence (Schlick's F0); 0 is diffuse.
        shine: (M,) float64, Phong strength of the lights' highlights; 0 is none.
        emission: (M,) float64, share of the colour that ignores the lighting, 1 for the far background.
        light: (L, 3) float64, light sample points in metres.
        light_axis: (L, 3) float64, direction in which the sample emits, weighted by the cosine; a zero vector emits evenly.
        light_colour: (L, 3) float64, radiant intensity.
        sun: (2, 3) float64, unit direction towards the sun, and its colour.
        ambient: (2, 3) float64, light from below and from above.
    """

    shape: np.ndarray
    to_local: np.ndarray
    size: np.ndarray
    param: np.ndarray
    material: np.ndarray
    group: np.ndarray
    bound: np.ndarray
    pattern: np.ndarray
    colours: np.ndarray
    texel: np.ndarray
    mirror: np.ndarray
    shine: np.ndarray
    emission: np.ndarray
    light: np.ndarray
    light_axis: np.ndarray
    light_colour: np.ndarray
    sun: np.ndarray
    ambient: np.ndarray


@compiled(inline="always", error_model="numpy")
def _to_local(world, p, v, w):
    """Vector `v` in the frame of primitive `p`; w = 1 for a point, 0 for a direction."""
    m = world.to_local
    return (
        m[p, 0, 0] * v[0] + m[p, 0, 1] * v[1] + m[p, 0, 2] * v[2] + m[p, 0, 3] * w,
        m[p, 1, 0] * v[0] + m[p, 1, 1] * v[1] + m[p, 1, 2] * v[2] + m[p, 1, 3] * w,
        m[p, 2, 0] * v[0] + m[p, 2, 1] * v[1] + m[p, 2, 2] * v[2] + m[p, 2, 3] * w,
    )


@compiled(inline="always", error_model="numpy")
def _hit_flat(world, p, o, d):
    """Ray parameter at the plane z = 0 inside the rectangle or disc, inf without a hit."""
    t = -o[2] / d[2]
    if not t > 0.0:
        return math.inf
    x, y = abs(o[0] + t * d[0]), abs(o[1] + t * d[1])
    if world.shape[p] == DISC:
        return t if x * x + y * y <= 1.0 else math.inf
    if x > 1.0 or y > 1.0 or (x < world.param[p, 0] and y < world.param[p, 1]):
        return math.inf
    return t


@compiled(inline="always", error_model="numpy")
def _hit_box(o, d):
    """Ray parameter at the unit box by the slab test, inf without a hit; a ray from inside hits the far side."""
    near, far = -math.inf, math.inf
    for k in range(3):
        a, b = (-1.0 - o[k]) / d[k], (1.0 - o[k]) / d[k]
        near, far = max(near, min(a, b)), min(far, max(a, b))
    if near > far or far <= 0.0:
        return math.inf
    return near if near > 0.0 else far


@compiled(inline="always", error_model="numpy")
def _hit_quadric(world, p, o, d):
    """Ray parameter at the unit sphere or the open frustum x^2 + y^2 = (1 + k z)^2, 0 <= z <= 1; inf without a hit."""
    tube = world.shape[p] == TUBE
    k = world.param[p, 0] - 1.0
    a = d[0] * d[0] + d[1] * d[1]
    b = o[0] * d[0] + o[1] * d[1]
    c = o[0] * o[0] + o[1] * o[1]
    if tube:
        r, slope = 1.0 + k * o[2], k * d[2]
        a, b, c = a - slope * slope, b - r * slope, c - r * r
    else:
        a, b, c = a + d[2] * d[2], b + o[2] * d[2], c + o[2] * o[2] - 1.0
    disc = b * b - a * c
    if disc < 0.0:
        return math.inf
    root = math.sqrt(disc)
    t0, t1 = (-b - root) / a, (-b + root) / a
    best = math.inf
    for t in (t0, t1):
        z = o[2] + t * d[2]
        if 0.0 < t < best and (not tube or 0.0 <= z <= 1.0):
            best = t
    return best


@compiled(inline="always", error_model="numpy")
def _misses_bound(world, g, o, d):
    """True if the ray from `o` along unit `d` cannot meet group `g`."""
    m = (world.bound[g, 0] - o[0], world.bound[g, 1] - o[1], world.bound[g, 2] - o[2])
    along, r2 = dot(m, d), world.bound[g, 3] ** 2
    m2 = dot(m, m)
    return m2 - along * along > r2 or (along < 0.0 and m2 > r2)


@compiled(error_model="numpy")
def _nearest(world, o, d, limit, any_hit):
    """(t, primitive) of the first hit along unit `d` within `limit`, or with `any_hit` of any; (limit, MISS) without one."""
    best, found = limit, MISS
    for g in range(len(world.group)):
        if _misses_bound(world, g, o, d):
            continue
        for p in range(world.group[g, 0], world.group[g, 1]):
            lo, ld = _to_local(world, p, o, 1.0), _to_local(world, p, d, 0.0)
            shape = world.shape[p]
            if shape == RECT or shape == DISC:
                t = _hit_flat(world, p, lo, ld)
            elif shape == BOX:
                t = _hit_box(lo, ld)
            else:
                t = _hit_quadric(world, p, lo, ld)
            if t < best:
                best, found = t, p
                if any_hit:
                    return best, found
    return best, found


@compiled(error_model="numpy")
def _local_surface(world, p, q):
    """(outward normal, u, v) at local point `q`: normal in the local frame, texture coordinates in metres."""
    shape, s = world.shape[p], world.size[p]
    if shape == RECT or shape == DISC:
        return (0.0, 0.0, 1.0), q[0] * s[0], q[1] * s[1]
    if shape == BALL:
        return q, math.atan2(q[1], q[0]) * s[0], math.asin(min(1.0, max(-1.0, q[2]))) * s[2]
    if shape == TUBE:
        k = world.param[p, 0] - 1.0
        return (q[0], q[1], -k * (1.0 + k * q[2])), math.atan2(q[1], q[0]) * s[0], q[2] * s[2]
    x, y, z = abs(q[0]), abs(q[1]), abs(q[2])
    if x >= y and x >= z:
        return (math.copysign(1.0, q[0]), 0.0, 0.0), q[1] * s[1], q[2] * s[2]
    if y >= z:
        return (0.0, math.copysign(1.0, q[1]), 0.0), q[0] * s[0], q[2] * s[2]
    return (0.0, 0.0, math.copysign(1.0, q[2])), q[0] * s[0], q[1] * s[1]


@compiled(error_model="numpy")
def _surface(world, p, at, d):
    """(unit normal facing the viewer, texture colour) of primitive `p` at world point `at` seen along `d`."""
    n, u, v = _local_surface(world, p, _to_local(world, p, at, 1.0))
    m = world.to_local[p]
    normal = normalise((
        m[0, 0] * n[0] + m[1, 0] * n[1] + m[2, 0] * n[2],
        m[0, 1] * n[0] + m[1, 1] * n[1] + m[2, 1] * n[2],
        m[0, 2] * n[0] + m[1, 2] * n[1] + m[2, 2] * n[2],
    ))
    if dot(normal, d) > 0.0:
        normal = scale(normal, -1.0)
    k = world.material[p]
    c = world.colours[k]
    base = texture(
        world.pattern[k], (c[0, 0], c[0, 1], c[0, 2]), (c[1, 0], c[1, 1], c[1, 2]), u / world.texel[k, 0], v / world.texel[k, 1]
    )
    return normal, base


@compiled(error_model="numpy")
def _lighting(world, at, normal, d, shine):
    """(light that arrives at a diffuse point, Phong highlight towards the viewer)."""
    up = 0.5 + 0.5 * normal[2]
    lo, hi = world.ambient[0], world.ambient[1]
    total = (lo[0] + (hi[0] - lo[0]) * up, lo[1] + (hi[1] - lo[1]) * up, lo[2] + (hi[2] - lo[2]) * up)
    highlight = (0.0, 0.0, 0.0)
    start = axpy(EPSILON, normal, at)
    mirrored = axpy(-2.0 * dot(d, normal), normal, d)
    for i in range(len(world.light) + 1):
        if i < len(world.light):
            away = (world.light[i, 0] - at[0], world.light[i, 1] - at[1], world.light[i, 2] - at[2])
            distance = math.sqrt(dot(away, away))
            to_light = scale(away, 1.0 / distance)
            axis = (world.light_axis[i, 0], world.light_axis[i, 1], world.light_axis[i, 2])
            emitted = max(0.0, -dot(axis, to_light)) if dot(axis, axis) > 0.0 else 1.0
            strength = emitted / (0.25 + distance * distance)  # the 0.25 m^2 limits the brightness right beside a light
            colour = (world.light_colour[i, 0], world.light_colour[i, 1], world.light_colour[i, 2])
        else:
            distance, strength = math.inf, 1.0
            to_light = (world.sun[0, 0], world.sun[0, 1], world.sun[0, 2])
            colour = (world.sun[1, 0], world.sun[1, 1], world.sun[1, 2])
        facing = dot(normal, to_light)
        if facing <= 0.0 or strength == 0.0:
            continue
        if _nearest(world, start, to_light, distance - 2 * EPSILON, True)[1] != MISS:
            continue
        total = axpy(strength * facing, colour, total)
        if shine > 0.0:
            highlight = axpy(shine * strength * max(0.0, dot(mirrored, to_light)) ** 40, colour, highlight)
    return total, highlight


@compiled(error_model="numpy")
def _shade(world, p, at, d):
    """(colour without mirror reflection, normal, mirror reflectance) of primitive `p` at `at` seen along unit `d`."""
    normal, base = _surface(world, p, at, d)
    k = world.material[p]
    emission = world.emission[k]
    colour = scale(base, emission)
    if emission < 1.0:
        light, highlight = _lighting(world, at, normal, d, world.shine[k])
        reflected = (base[0] * light[0], base[1] * light[1], base[2] * light[2])
        colour = add(axpy(1.0 - emission, reflected, colour), highlight)
    f0 = world.mirror[k]
    mirror = f0 + (1.0 - f0) * (1.0 + dot(d, normal)) ** 5 if f0 > 0.0 else 0.0
    return colour, normal, mirror


@compiled(error_model="numpy")
def _radiance(world, o, d):
    """(t, primitive, normal, colour) along the unit ray `d`, with one mirror bounce whose hit does not reflect again."""
    t, p = _nearest(world, o, d, math.inf, False)
    if p == MISS:
        return t, p, scale(d, -1.0), sky(d)
    at = axpy(t, d, o)
    colour, normal, mirror = _shade(world, p, at, d)
    if mirror > 0.0:
        bounce = axpy(-2.0 * dot(d, normal), normal, d)
        start = axpy(EPSILON, normal, at)
        t2, p2 = _nearest(world, start, bounce, math.inf, False)
        seen = sky(bounce) if p2 == MISS else _shade(world, p2, axpy(t2, bounce, start), bounce)[0]
        colour = axpy(mirror, seen, scale(colour, 1.0 - mirror))
    return t, p, normal, colour


@compiled(parallel=True, error_model="numpy")
def _trace(world, origin, direction, distance, primitive, normal, colour):
    for i in prange(len(origin)):
        o = (origin[i, 0], origin[i, 1], origin[i, 2])
        d = (direction[i, 0], direction[i, 1], direction[i, 2])
        distance[i], primitive[i], n, c = _radiance(world, o, d)
        for k in range(3):
            normal[i, k] = n[k]
            colour[i, k] = min(1.0, max(0.0, c[k]))


def trace(world: World, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Trace rays to their first hit.

    Args:
        world: the scene.
        origin: (N, 3) float64, metres.
        direction: (N, 3) float64, unit vectors.

    Returns:
        distance: (N,) float64 along the ray in metres, inf where the ray reaches the sky.
        primitive: (N,) int64 index of the primitive hit, MISS for the sky.
        normal: (N, 3) float64 unit normal facing the origin; minus the direction for the sky.
        colour: (N, 3) float64 in [0, 1], as displayed.
    """
    n = len(origin)
    distance, primitive = np.empty(n), np.empty(n, np.int64)
    normal, colour = np.empty((n, 3)), np.empty((n, 3))
    rays = (np.ascontiguousarray(origin, float), np.ascontiguousarray(direction, float))
    _trace(world, *rays, distance, primitive, normal, colour)
    return distance, primitive, normal, colour
