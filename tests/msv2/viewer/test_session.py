"""The viewer's session, without a browser: pictures follow the state, numbers are those of `msv2 perf`."""

import io
import json
from dataclasses import replace

import numpy as np
import pytest

from golden import render
from golden.scenes.camera_file import load_camera
from golden.scenes.pictures import to_bytes
from golden.scenes.save import save_model
from msv2.viewer import pictures
from msv2.viewer.command import make_session, parse_arguments
from msv2.viewer.session import Session
from msv2.viewer.state import ANAGLYPH, EYES, FLOAT, ONE, OVERLAYS, SIDE_BY_SIDE, State, fitted
from perf import __main__ as perf
from spec.errors import InputError
from tests.helpers.golden_samples import ball

SIZE = "96x64"


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("scene") / "ball.ply"
    save_model(ball(), path)
    return str(path)


def open_session(scene: str, *argv: str) -> Session:
    return make_session(parse_arguments([scene, "--size", SIZE, *argv]))


@pytest.fixture(scope="module")
def session(scene) -> Session:
    return open_session(scene)


@pytest.fixture(scope="module")
def gazed(session) -> State:
    """A state with a gaze near the left edge, so that all four levels are there."""
    return replace(session.with_levels(session.state, 4), gaze=(10.0, 20.0), marked=False)


def turned(state: State, degrees: float) -> State:
    """The camera turned about its own vertical axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return state.posed(np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ state.camera.rotation, state.camera.position)


def image(session: Session, state: State, **changes: object) -> np.ndarray:
    return session.picture(replace(state, **changes)).image


def test_the_picture_is_that_of_render(session, scene, tmp_path):
    """Bit for bit, with a gaze, too."""
    from PIL import Image

    for gaze in (None, (10.0, 20.0)):
        state = replace(session.with_levels(session.state, 4), gaze=gaze, marked=False)
        given = ["--gaze", "10,20"] if gaze else []
        render.main([scene, "--size", SIZE, "--levels", "4", *given, "--out", str(tmp_path)])
        assert (session.picture(state).image == np.asarray(Image.open(tmp_path / "frame.png"))).all()


def test_pictures_follow_camera_gaze_levels_and_lens(session, gazed):
    first = image(session, gazed)
    assert (image(session, gazed) == first).all()
    for other in (turned(gazed, 5), replace(gazed, gaze=(90.0, 40.0)), replace(gazed, gaze=None), gazed.zoomed(0.4),
                  session.with_levels(gazed, 2)):
        assert (image(session, other) != first).any()


def test_the_model_is_quantised_once(scene, monkeypatch):
    from msv2.viewer import session as module

    counted = []
    quantise = module.quantise_model
    monkeypatch.setattr(module, "quantise_model", lambda *args: counted.append(1) or quantise(*args))
    opened = open_session(scene)
    for degrees in range(3):
        opened.picture(turned(opened.state, degrees))
    assert counted == [1]
    opened.picture(replace(opened.with_levels(opened.state, 4), gaze=(5.0, 5.0)))
    opened.picture(turned(opened.state, 4))
    assert counted == [1, 1]


@pytest.mark.parametrize("overlay", OVERLAYS)
def test_overlays_show(session, gazed, overlay):
    plain, shown = image(session, gazed), image(session, gazed, overlay=overlay)
    assert shown.shape == plain.shape
    assert (shown != plain).any() == (overlay not in ("none", "warp"))  # one eye warps nothing


def test_the_level_overlay_tints_each_level(session, gazed):
    tint = image(session, gazed, overlay="levels").astype(int)
    corner = tint[:16, -16:].mean((0, 1))
    gaze = tint[16:32, :16].mean((0, 1))
    assert gaze[0] - gaze[2] > corner[0] - corner[2]  # red at the gaze, blue far from it


def test_the_error_overlay_is_the_difference_times_the_gain(session, gazed):
    golden = session.golden(gazed).image
    exact = session.picture(replace(gazed, renderer=FLOAT))
    assert exact.image.shape == golden.shape
    picture = session.picture(replace(gazed, overlay="error", gain=200.0))
    floats = session._float_images(gazed, exact=True)[0]
    assert (picture.image == to_bytes(np.abs(np.clip(golden, 0, 1) - np.clip(floats, 0, 1)) * 200)).all()
    assert picture.image.any() and " dB" in picture.notes[0]
    assert float(picture.notes[0].split(": ")[1].split(" dB")[0]) > 40


def test_float_renderers_agree(session):
    """The fast one while the camera moves, the oracle at rest."""
    state = replace(session.state, renderer=FLOAT)
    fast, exact = session.picture(state, moving=True).image, session.picture(state).image
    assert np.abs(fast.astype(int) - exact).max() <= 1


@pytest.mark.parametrize("renderer", ["golden", FLOAT])
def test_two_eyes(session, gazed, renderer):
    state = replace(gazed, renderer=renderer, units_per_metre=5.0)
    pair = image(session, state, eyes=SIDE_BY_SIDE)
    left, right = pair[:, :96], pair[:, 96:]
    assert pair.shape == (64, 192, 3) and (left != right).any()
    assert (left == image(session, state)).all()
    both = image(session, state, eyes=ANAGLYPH)
    assert (both[..., 0] == left[..., 0]).all() and (both[..., 1:] == right[..., 1:]).all()


def test_overlays_of_two_eyes(session, gazed):
    state = replace(gazed, eyes=SIDE_BY_SIDE, units_per_metre=5.0)
    plain = image(session, state)
    for overlay, changed in (("levels", (True, True)), ("error", (True, True)), ("depth", (True, False)),
                             ("warp", (False, True)), ("intersections", (True, True))):
        shown = image(session, state, overlay=overlay)
        halves = ((shown[:, half] != plain[:, half]).any() for half in (slice(0, 96), slice(96, 192)))
        assert tuple(map(bool, halves)) == changed, overlay


def test_the_gaze_is_marked(session, gazed):
    plain, marked = image(session, gazed), image(session, gazed, marked=True)
    rows, columns = np.nonzero((plain != marked).any(2))
    assert abs(rows - 20).max() <= 5 and abs(columns - 10).max() <= 5


@pytest.mark.parametrize("argv", [
    (), ("--gaze", "10,20", "--levels", "4"), ("--stereo", "--ecc-thresh", "20", "--units-per-metre", "5"),
    ("--effects", "sh", "--bandwidth", "unlimited"), ("--memory", "lpddr3"),
    ("--memory", "lpddr3", "--clock-mhz", "500"),
    ("--machine", "full", "--merge", "0", "--pipeline", "0", "--depth"),
])
def test_numbers_are_those_of_perf(scene, tmp_path, argv, monkeypatch):
    monkeypatch.setattr(perf, "CACHE", tmp_path / "traces")
    perf.main([scene, "--size", SIZE, "--config", "paper", "--out", str(tmp_path), *argv])
    expected = json.loads((tmp_path / "perf.json").read_text())
    opened = open_session(scene, *argv)
    found = json.loads(json.dumps(opened.numbers(opened.state).as_json(), default=float))
    for name in ("total", "phases", "eyes", "stages", "dram_bytes", "entries", "groups", "ops", "skipped", "fetch_misses",
                 "spilled_entries", "utilisation", "effects"):
        assert found[name] == expected[name], name
    assert found["frames_per_s"] == 1e6 * expected["clock_mhz"] / expected["total"]


def test_energy_is_that_of_the_studys_tables(session):
    from msv2.studies.energy.frame import frame_energy, load_table, model_counts
    from perf.model import simulate
    from perf.trace import trace_of

    state, golden = session.state, session.golden(session.state)
    machine = session.work(state).config
    trace = trace_of(golden)
    cycles = simulate(trace, machine, display=False)
    expected = frame_energy(model_counts(trace, cycles), cycles.total, machine, load_table())
    assert session.numbers(state).energy == expected and expected.total_mj > 0


def test_the_numbers_are_shown(session):
    numbers = session.numbers(session.state)
    assert f"{numbers.cycles.entries:,} intersections" in numbers.summary()
    text = numbers.markdown()
    for stage, cycles in numbers.cycles.stages.items():
        assert f"| {stage} | {cycles.busy:,} |" in text
    assert f"{numbers.energy.chip_mj:.3f}" in text and "`paper`" in text


def test_an_exported_camera_draws_the_same_frame(session, gazed, scene, tmp_path):
    from PIL import Image

    state = turned(gazed, 7).zoomed(0.8)
    path = tmp_path / "camera.json"
    path.write_text(session.exported(state))
    assert (load_camera(path).rotation == state.camera.rotation).all()
    render.main([scene, "--camera", str(path), "--levels", "4", "--out", str(tmp_path / "out")])
    assert (np.asarray(Image.open(tmp_path / "out" / "frame.png")) == session.picture(state).image).all()
    assert json.loads((tmp_path / "out" / "stats.json").read_text())["gaze"] == [10.0, 20.0]
    render.main([scene, "--camera", str(path), "--levels", "4", "--gaze", "none", "--out", str(tmp_path / "out")])
    assert json.loads((tmp_path / "out" / "stats.json").read_text())["gaze"] is None


def test_cameras_of_an_orbit_are_those_of_the_command_line(session, scene):
    from golden.scenes.request import parse_request, resolve

    with pytest.raises(InputError, match=r"0\.\.7"):
        resolve(parse_request(scene, "--camera", str(len(session.cameras))))
    expected = resolve(parse_request(scene, "--size", SIZE, "--camera", "3")).camera
    camera = session.camera(session.cameras[3])
    assert (camera.rotation == expected.rotation).all() and (camera.translation == expected.translation).all()


def test_stored_cameras_keep_their_shape(scene, monkeypatch):
    from golden.scenes import request
    from golden.scenes.orbit import orbit_camera

    load = request.load_scene

    def with_cameras(*place):
        loaded = load(*place)
        start = orbit_camera(loaded.model, 0, 8, 4000, 3000, up=np.array([0.0, 0.6, -0.8]))
        return replace(loaded, cameras=(start, replace(start, name="second", width=3000)))

    monkeypatch.setattr(request, "load_scene", with_cameras)
    opened = make_session(parse_arguments([scene, "--camera", "1"]))
    assert opened.cameras[1] == "1: second"
    sizes = [opened.camera(name) for name in opened.cameras]
    assert [round(c.width / c.height, 1) for c in sizes] == [1.3, 1.0] and all(c.width * c.height <= 640 * 370 for c in sizes)
    assert opened.state.size == (sizes[1].width, sizes[1].height)
    assert sizes[0].fx == pytest.approx(sizes[0].fy, rel=0.01)
    assert opened.up @ -sizes[0].rotation[1] == pytest.approx(1)  # up is where the cameras have it


def test_the_point_that_the_mouse_turns_around_is_in_the_scene(session):
    """The near side of the ball or its middle, seen from the orbit."""
    camera = session.state.camera
    distance = np.linalg.norm(camera.position)
    assert distance - 1.3 < session.focus_distance(camera) < distance + 1.3
    away = turned(session.state, 180).camera
    assert session.focus_distance(away) > 0


def test_moving_frames_are_smaller(session, gazed):
    small = gazed.moving()
    assert small.size == (48, 32) and small.gaze == (5.0, 10.0)
    assert session.picture(small, moving=True).image.shape == (32, 48, 3)
    assert replace(gazed, gaze=None).resized(192, 128).vertical_fov == pytest.approx(gazed.vertical_fov)


def test_effects_that_the_frame_needs_cannot_be_left_out(session, gazed):
    with pytest.raises(InputError, match="this frame calls for more"):
        session.picture(replace(gazed, effects="none"))
    forced = replace(session.state, effects="all")
    assert (image(session, forced) == image(session, session.state)).all()
    assert session.numbers(forced).cycles.total > session.numbers(session.state).cycles.total


@pytest.mark.parametrize(("field", "value"), [("eyes", "three"), ("renderer", "fast"), ("overlay", "fog")])
def test_unknown_words_are_refused(session, field, value):
    with pytest.raises(InputError, match=value):
        replace(session.state, **{field: value})


@pytest.mark.parametrize(("argv", "says"), [
    (["--port", "70000"], "port 70000"), (["--clock-mhz", "0"], "clock of 0.0"), (["--memory", "ddr"], "memory 'ddr'"),
    (["--frames", "1"], "frames 1"), (["--gaze", "5"], "gaze '5'"), (["--config", "huge"], "config 'huge'")])
def test_bad_options_are_named(scene, argv, says):
    with pytest.raises(InputError, match=says):
        open_session(scene, *argv)


@pytest.mark.parametrize(("shape", "aspect", "bars"), [
    ((36, 64), 16 / 9, (0, 0)), ((36, 64), 2.0, (0, 4)), ((36, 64), 1.0, (14, 0)), ((64, 36), 1.0, (0, 14))])
def test_bars_fill_the_window(shape, aspect, bars):
    framed = pictures.letterboxed(np.full((*shape, 3), 200, np.uint8), aspect)
    assert framed.shape[1] / framed.shape[0] == pytest.approx(aspect, rel=0.02)
    assert tuple(np.argmax((framed == 200).all(2).any(axis)) for axis in (1, 0)) == bars
    height, width = shape
    for x, y in ((0.01, 0.01), (0.5, 0.5), (0.99, 0.99)):
        place = ((bars[1] + x * width) / framed.shape[1], (bars[0] + y * height) / framed.shape[0])
        assert pictures.place_in_picture(place, framed.shape[1] / framed.shape[0], width, height) == pytest.approx(
            (x * width, y * height), abs=0.01)
    if any(bars):
        assert pictures.place_in_picture((0.001, 0.001), aspect, width, height) is None


def test_large_cameras_are_fitted(session):
    camera = fitted(session.state.camera.resized(4000, 1000))
    assert camera.width * camera.height <= 640 * 362 and camera.width == pytest.approx(4 * camera.height, abs=4)
    assert fitted(session.state.camera) is session.state.camera


def test_pictures_of_every_kind_are_whole(session, gazed):
    """Every choice of eyes and overlay gives a picture that JPEG takes."""
    from PIL import Image

    for eyes in EYES:
        for overlay in OVERLAYS:
            picture = image(session, gazed, eyes=eyes, overlay=overlay, units_per_metre=5.0)
            Image.fromarray(pictures.letterboxed(picture, 1.3)).save(io.BytesIO(), format="JPEG")
            assert picture.dtype == np.uint8 and picture.shape == (64, 96 if eyes != SIDE_BY_SIDE else 192, 3)
    assert pictures.needs_golden(replace(gazed, overlay="depth")) and not pictures.needs_golden(replace(gazed, eyes=ONE))
