"""The package as a user has it: installed, with its program."""

import json
import logging
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radcam


def program(*arguments: str | os.PathLike[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["radcam", *arguments], capture_output=True, text=True)


@pytest.mark.skipif(not radcam.HAS_ARAVIS, reason="built without libaravis")
def test_ten_lines(served: str, tmp_path: Path) -> None:
    os.chdir(tmp_path)
    camera = radcam.Camera(served)
    camera.set_exposure_s(0.004)
    frames = list(camera.frames(4))
    print(radcam.statistics(frames, bit_depth=12).var_dn2)
    del camera
    radcam.capture(served, "campaign", "quick", region=(0, 0, 128, 96))
    print(radcam.noise("campaign").gain_dn_per_e, radcam.diagnose("campaign").verdict)
    calibration = radcam.calibrate("campaign", "cal.tiff", "smooth")
    corrector = calibration.corrector(exposure_s=0.004)
    corrected = corrector.correct(np.ascontiguousarray(frames[0][:96, :128]))
    # What the lines gave.
    assert len(frames) == 4 and frames[0].dtype == np.uint16 and frames[0].ndim == 2
    gain = radcam.noise("campaign").gain_dn_per_e
    assert abs(gain.value - 0.38) < 5 * gain.std_err
    assert radcam.diagnose("campaign").consistent
    assert corrected.dtype == np.float32 and corrected.shape == (96, 128)
    # Light and no black level are left: an exposure of 4 ms gives some hundred DN.
    assert 10 < corrected.mean() < 4095


def test_numbers_are_those_of_the_program(campaign: Path, lagging: Path) -> None:
    for path in (campaign, lagging):
        for verb, ours in (("noise", radcam.noise), ("diagnose", radcam.diagnose), ("compare", radcam.compare)):
            said = program(verb, path, "--json")
            assert said.returncode in (0, 1), said.stderr
            assert json.loads(said.stdout) == ours(path).json(), f"{verb} {path}"


def test_a_hidden_effect_is_named(lagging: Path) -> None:
    found = radcam.diagnose(lagging)
    assert found.kind == "named" and found.effects == ["row-noise"]
    assert abs(found.missing[0].parameters["e"].value - 4.0) < 5 * found.missing[0].parameters["e"].std_err
    assert found.error_after < 1.2 < found.error_before
    fitted = radcam.Model.load("cmos12").add("row-noise").fit(lagging)
    assert fitted.effects == ["row-noise"] and fitted.remove("row-noise").effects == []


def test_results_show_themselves(campaign: Path) -> None:
    for result in (radcam.noise(campaign), radcam.diagnose(campaign), radcam.compare(campaign)):
        page = result._repr_html_()
        assert "<table>" in page and "<svg" in page and "nan" not in page.lower().split("<svg")[0]
        assert len(result.to_frame()) > 0
    q = radcam.noise(campaign).gain_dn_per_e
    assert str(q).endswith("DN/e") and "±" in str(q)


def test_frames_and_statistics(campaign: Path) -> None:
    dataset = radcam.Dataset(campaign)
    assert dataset.shape == (64, 96) and dataset.bit_depth == 12
    flat = max((s for s in dataset.sets if s.kind == "flat"), key=lambda s: s.exposure_s)
    frames = list(dataset.frames(flat))
    stack = np.stack(frames)
    whole = radcam.moments(frames, 12)
    # numpy's sums round, ours do not.
    np.testing.assert_allclose(whole.mean_dn(), stack.mean(0), rtol=1e-14)
    np.testing.assert_allclose(whole.variance_dn2(), stack.var(0, ddof=1), rtol=1e-9)
    part = radcam.moments(frames[:1], 12)
    part.merge(radcam.moments(iter(frames[1:]), 12))
    assert np.array_equal(part.variance_dn2(), whole.variance_dn2()) and part.frames == len(frames)
    found = radcam.statistics((f for f in frames), 12)
    # The residual mean square of pixel and frame: the frames' own means taken off.
    residual = stack - stack.mean(0) - stack.mean((1, 2), keepdims=True) + stack.mean()
    expected = (residual**2).sum() / ((len(frames) - 1) * stack[0].size)
    assert abs(found.var_dn2.value / expected - 1) < 1e-3
    assert found.frames == len(frames)
    for wrong in (stack.astype(np.float32)[0], frames[0][:10]):
        with pytest.raises((TypeError, ValueError)):
            whole.add(wrong)
    with pytest.raises(ValueError, match="4000 DN"):
        radcam.moments([np.full((4, 4), 4000, np.uint16)], 11)
    with pytest.raises(ValueError, match="two frames"):
        radcam.statistics(frames[:1])


def test_correction(campaign: Path, tmp_path: Path) -> None:
    calibration = radcam.calibrate(campaign, tmp_path / "cal.tiff", "smooth")
    exposure_s = 0.004
    corrector = calibration.corrector(exposure_s)
    frame = radcam.Dataset(campaign).read(20)
    expected = (frame - calibration.dark_dn(exposure_s)) / calibration.k
    got = corrector.correct(frame)
    # Maps are kept as half floats about their median: Corrector says how much that rounds.
    np.testing.assert_allclose(got, expected, rtol=1e-4, atol=0.02)
    out = np.empty_like(got)
    assert corrector.correct(frame, out=out) is out and np.array_equal(out, got)
    codes = corrector.correct_codes(frame, scale=4.0, offset=100.0)
    assert np.abs(codes - np.clip(4.0 * got + 100.0, 0, 65535)).max() <= 0.51
    assert corrector.correct_codes(frame, scale=4.0, offset=100.0, out=frame) is frame
    assert np.array_equal(frame, codes)
    with pytest.raises(radcam.CorrectError, match="pixels"):
        corrector.correct(np.zeros((3, 3), np.uint16))
    # In Fortran's order the bytes are those of the transpose: read as what they are, and refused to be written.
    fortran = corrector.correct(np.asfortranarray(frame))
    assert np.array_equal(fortran, corrector.correct(frame))
    assert np.array_equal(corrector.correct(frame[::-1][::-1]), fortran)
    with pytest.raises(ValueError, match="ascontiguousarray"):
        corrector.correct_codes(frame, out=np.asfortranarray(frame))
    with pytest.raises(radcam.CorrectError, match="pixels"):
        corrector.correct(np.zeros(frame.shape[::-1], np.uint16))


def test_the_simulator_draws_what_it_draws() -> None:
    sensor = radcam.Sensor("cmos12", seed=3)
    a, b = sensor.draw(5, 0.004), sensor.draw(5, 0.004)
    assert np.array_equal(a, b) and a.shape == sensor.shape
    out = np.empty(sensor.shape, np.uint16)
    assert sensor.draw(5, 0.004, out=out) is out and np.array_equal(out, a)
    assert not np.array_equal(sensor.draw(6, 0.004), a)
    with pytest.raises(ValueError, match="out is not"):
        sensor.draw(1, 0.004, out=np.empty((2, 2), np.uint16))
    with pytest.raises(ValueError, match="ascontiguousarray"):
        sensor.draw(1, 0.004, out=np.empty(sensor.shape, np.uint16, order="F"))
    with pytest.raises(ValueError, match="exposure_s"):
        sensor.draw(1, float("nan"))


def test_a_simulated_camera_is_an_iterator() -> None:
    camera = radcam.Camera("sim:cmos12")
    x, y, width, height = camera.set_region(0, 0, 64, 48)
    assert camera.set_exposure_s(0.002) == pytest.approx(0.002)
    with camera.frames() as frames:
        first = next(frames)
        assert first.shape == (height, width) and frames.last is not None
        with pytest.raises(radcam.CameraError, match="being read"):
            camera.settings()
        with pytest.raises(radcam.CameraError, match="close them"):
            camera.frames()
    assert camera.settings()["region"] == (x, y, width, height)
    assert sum(1 for _ in camera.frames(7)) == 7
    assert list(camera.frames(0)) == []


def test_errors_are_named(tmp_path: Path) -> None:
    with pytest.raises(radcam.DatasetError, match="nowhere"):
        radcam.noise(tmp_path / "nowhere")
    with pytest.raises(radcam.CameraError, match="no backend"):
        radcam.Camera("usb:1")
    with pytest.raises(radcam.ModelError, match="no-such-effect"):
        radcam.Model.load("cmos12").add("no-such-effect")
    with pytest.raises(radcam.PlanError, match="no plan"):
        radcam.simulate("cmos12", tmp_path / "x", "no-such-plan")
    with pytest.raises(radcam.CalibrateError):
        (tmp_path / "cal.tiff").write_bytes(b"no TIFF")
        radcam.Calibration(tmp_path / "cal.tiff")
    assert issubclass(radcam.NoiseError, radcam.RadcamError)


def test_a_mosaic_is_measured_plane_by_plane(tmp_path: Path) -> None:
    path = tmp_path / "mosaic"
    radcam.simulate("cmos12", path, "quick", region=(0, 0, 96, 64), seed=17)
    manifest = path / "dataset.toml"
    manifest.write_text(manifest.read_text().replace('"Mono12"', '"BayerRG12"'))
    with pytest.raises(radcam.DatasetError, match="colour mosaic"):
        radcam.noise(path)
    for verb, ours in (("noise", radcam.noise), ("diagnose", radcam.diagnose), ("compare", radcam.compare)):
        said = program(verb, path, "--plane", "0,1", "--json")
        assert said.returncode in (0, 1), said.stderr
        assert json.loads(said.stdout) == ours(path, plane=(0, 1)).json(), verb
    radcam.reduce(path, tmp_path / "green.stats", plane=(1, 0))
    assert radcam.noise(tmp_path / "green.stats").gain_dn_per_e == radcam.noise(path, plane=(1, 0)).gain_dn_per_e
    with pytest.raises(ValueError, match=r"plane is \(2, 0\)"):
        radcam.noise(path, plane=(2, 0))


def test_ctrl_c_ends_long_work(tmp_path: Path) -> None:
    threading.Timer(0.7, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
    begun = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        radcam.simulate("cmos12", tmp_path / "long", "standard")
    # The standard plan of the whole sensor takes longer than that by far.
    assert time.monotonic() - begun < 10


def test_other_threads_run_meanwhile(campaign: Path) -> None:
    counted = [0]
    end = threading.Event()

    def count() -> None:
        while not end.is_set():
            counted[0] += 1
            time.sleep(0.001)

    thread = threading.Thread(target=count)
    thread.start()
    try:
        radcam.diagnose(campaign)
    finally:
        end.set()
        thread.join()
    assert counted[0] > 5


def test_progress_is_told(campaign: Path) -> None:
    told: list[tuple[int, int]] = []
    radcam.noise(campaign, progress=lambda done, of: told.append((done, of)))
    assert told and told[-1][0] == told[-1][1]
    with pytest.raises(ZeroDivisionError):
        radcam.noise(campaign, progress=lambda done, of: 1 // 0)


def test_what_is_done_is_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, logger="radcam"):
        radcam.simulate("cmos12", tmp_path / "c", "quick", region=(0, 0, 32, 32))
    assert any(r.name.startswith("radcam.cameras.capture") and r.levelno == logging.INFO for r in caplog.records), caplog.text


def test_the_program_comes_with_it() -> None:
    said = program("--version")
    assert said.stdout.strip() == f"radcam {radcam.__version__}"
    assert program("noise", "/nowhere").returncode == 2
    again = subprocess.run([sys.executable, "-m", "radcam", "--version"], capture_output=True, text=True)
    assert again.stdout == said.stdout


def test_types_agree() -> None:
    """mypy finds nothing in the package, and the stubs say what is there."""
    checked = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--ignore-missing-imports", "--allow-untyped-calls", "-p", "radcam"], capture_output=True, text=True
    )
    assert checked.returncode == 0, checked.stdout
    stubs = subprocess.run([sys.executable, "-m", "mypy.stubtest", "radcam._radcam"], capture_output=True, text=True)
    assert stubs.returncode == 0, stubs.stdout + stubs.stderr


def test_what_users_hand_over(campaign: Path, tmp_path: Path) -> None:
    """Views, other byte orders and 8-bit codes are taken as what they are; what cannot be meant is refused by name, and nothing is overwritten."""
    dn = np.random.default_rng(5).integers(0, 200, (8, 6, 10), dtype=np.uint16)
    mean = dn.mean(axis=0)
    for frames in (dn, dn.astype(np.uint8), dn.astype(">u2"), np.ascontiguousarray(dn[:, :, ::-1])[:, :, ::-1], np.asfortranarray(dn)):
        assert np.array_equal(radcam.moments(frames, 8).mean_dn(), mean)
        assert radcam.statistics(frames, 8).json() == radcam.statistics(dn, 8).json()
    refused: list[tuple[type[BaseException], str, Any]] = [
        (TypeError, "uint8 or uint16", lambda: radcam.moments(dn.astype(float))),
        (TypeError, "masked", lambda: radcam.statistics(np.ma.masked_greater(dn, 100))),
        (TypeError, "dimensions", lambda: radcam.moments(dn[0])),
        (ValueError, "makes no image", lambda: radcam.statistics(np.zeros((3, 0, 4), np.uint16))),
        (MemoryError, "do not fit", lambda: radcam.Moments((10**9, 10**9))),
        (ValueError, "no common mean", lambda: radcam.Moments((2, 2), 8).merge(radcam.Moments((2, 2), 12))),
        (ValueError, "timeout_s", lambda: radcam.Camera("sim:cmos12").frames(1, timeout_s=1e300)),
        (FileExistsError, "overwrite=True", lambda: radcam.reduce(campaign, campaign / "frames.csv")),
        (FileExistsError, "overwrite=True", lambda: radcam.Model.load("cmos12").save(campaign / "frames.csv")),
        (ValueError, "full_exposure_s", lambda: radcam.capture("sim:cmos12", tmp_path / "c", full_exposure_s=float("nan"))),
    ]
    for kind, text, call in refused:
        with pytest.raises(kind, match=text):
            call()
    corrector = radcam.calibrate(campaign, tmp_path / "cal.tiff", "smooth").corrector(0.001)
    with pytest.raises(FileExistsError):
        radcam.calibrate(campaign, tmp_path / "cal.tiff", "smooth")
    frame = radcam.Dataset(campaign).read(0)
    memory = np.zeros(2 * frame.size, np.float32)
    view = memory.view(np.uint16)[: frame.size].reshape(frame.shape)
    with pytest.raises(ValueError, match="shares memory"):
        corrector.correct(view, memory[: frame.size].reshape(frame.shape))
    for bad in (float("nan"), -1.0):
        with pytest.raises(radcam.CorrectError, match="exposure"):
            radcam.Calibration(tmp_path / "cal.tiff").corrector(bad)
    with pytest.raises(ValueError, match="scale"):
        corrector.correct_codes(frame, scale=float("nan"))


def test_a_camera_is_an_iterator_and_has_light(tmp_path: Path) -> None:
    camera = radcam.Camera("sim:cmos12")
    camera.set_region(0, 0, 64, 48)
    camera.set_exposure_s(0.01)
    dark = next(iter(camera)).mean()
    camera.set_light(1.0)
    assert next(iter(camera)).mean() > dark + 50
    model = radcam.Model.load("cmos12").add("row-noise", e=4.0)
    assert radcam.Sensor(model, seed=3).draw(1, 0.01).shape == radcam.Sensor("cmos12").shape
    radcam.simulate(model, tmp_path / "c", "quick", region=(0, 0, 64, 48), seed=3)
    assert not radcam.compare(tmp_path / "c").consistent
    assert radcam.compare(tmp_path / "c", model).consistent
    # A whole capture is resumed: nothing is left to do.
    assert radcam.capture("sim:cmos12", tmp_path / "d", "quick", region=(0, 0, 64, 48))["frames"] > 0
    radcam.capture("sim:cmos12", tmp_path / "d", resume=True)


def test_a_fork_is_told(campaign: Path) -> None:
    """Threads do not come with a fork: what would wait for ever is an error."""
    script = (
        "import multiprocessing as m, sys, radcam\n"
        "def work(path): return radcam.noise(path).gain_dn_per_e.value\n"
        "work(sys.argv[1])\n"
        "if __name__ == '__main__':\n"
        "    with m.get_context('fork').Pool(1) as pool:\n"
        "        try: pool.map_async(work, [sys.argv[1]]).get(30)\n"
        "        except radcam.RadcamError as e: print(e)\n"
    )
    done = subprocess.run([sys.executable, "-c", script, str(campaign)], capture_output=True, text=True, timeout=120)
    assert "spawn" in done.stdout, done
