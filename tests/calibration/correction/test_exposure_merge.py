"""Several exposures of a band as one measurement: unbiased, of the stated variance, better than each alone."""

from dataclasses import replace

import numpy as np
import pytest
import tifffile
from cboxlab.calibration.capture import BracketTable, load_capture
from cboxlab.calibration.correction import CorrectedBands, correct_bands, measure_noise, read_darks
from cboxlab.calibration.correction.correction import CorrectedFrames
from cboxlab.calibration.correction.exposure_agreement import exposure_findings
from cboxlab.calibration.correction.exposure_merge import Exposure
from cboxlab.calibration.instrument import Mask
from cboxlab.calibration.quality.frame_checks.schedule import check_brackets

GAIN, READ, BIAS, FULL = 4.0, 6.0, 60.0, 1023
SHAPE = (64, 96)
TIMES = (0.5, 0.125, 2.0)


def ramp(lowest=0.02, highest=16000.0):
    """Light in DN/s, from a dark corner to one that only the shortest exposure holds."""
    v, u = np.indices(SHAPE)
    return lowest * (highest / lowest) ** ((u + v / SHAPE[0]) / SHAPE[1])


def write(folder, seed, times=TIMES, true_times=None, light=None, head="", repeats=1, offset_s=0.0, extra=""):
    """A capture of one band with brackets, drawn from the format's own equation."""
    generator, light = np.random.default_rng(seed), ramp() if light is None else light
    (folder / "frames").mkdir(parents=True)
    text = (
        f'format = "capture/1"\n{head}[camera]\nwidth_px = {SHAPE[1]}\nheight_px = {SHAPE[0]}\nbit_depth = 10\n'
        f"gain_e_per_dn = {GAIN}\nread_noise_e = {READ}\n{extra}"
    )

    def frame(name, signal):
        electrons = generator.poisson(GAIN * signal) + READ * generator.standard_normal(SHAPE)
        counts = np.clip(np.rint(electrons / GAIN + BIAS), 0, FULL)
        tifffile.imwrite(folder / "frames" / name, counts.astype(np.uint16))
        return f'"frames/{name}"'

    for index, time in enumerate(times):
        true = (true_times or times)[index] + offset_s
        names = ", ".join(frame(f"{index}-{k}.tif", light * true) for k in range(repeats))
        table = '[[band]]\nid = "a"' if index == 0 else '[[bracket]]\nband = "a"'
        text += f"{table}\nexposure_s = {time}\nframes = [{names}]\n"
        darks = ", ".join(frame(f"dark{index}-{k}.tif", 0 * light) for k in range(8))
        text += f"[[dark]]\nexposure_s = {time}\nframes = [{darks}]\n"
    (folder / "capture.toml").write_text(text)
    return corrected(folder)


def corrected(folder) -> CorrectedBands:
    capture = load_capture(folder)
    dark = read_darks(capture)
    return correct_bands(capture, dark, measure_noise(capture, dark))


@pytest.fixture(scope="module")
def draws(tmp_path_factory):
    """Merged signals of two dozen captures of one light."""
    root = tmp_path_factory.mktemp("draws")
    return [write(root / str(seed), seed) for seed in range(24)]


def test_pulls_of_merged_signals_are_standard_normal(draws):
    truth = ramp() * TIMES[0]
    used = np.all([d.images["mask"].values[0] & int(Mask.SATURATED) == 0 for d in draws], axis=0)
    assert used.mean() > 0.9
    pulls = np.array(
        [((d.images["signal"].values[0] - truth) / np.sqrt(d.predicted_variance(truth[None])[0]))[used] for d in draws]
    )
    count = pulls.size
    assert abs(pulls.std() - 1) < 0.02
    # by level of light: darkness, read noise, shot noise, both edges of saturation
    for level in np.array_split(np.argsort(truth[used]), 12):
        mean, spread = pulls[:, level].mean(), pulls[:, level].std()
        assert abs(mean) < 5 / np.sqrt(count / 12) + 0.02, "biased"
        assert abs(spread - 1) < 0.03
    assert abs(pulls.mean()) < 5 / np.sqrt(count) + 0.01


def test_no_bias_where_exposures_begin_to_saturate(draws):
    truth = ramp()
    total, count = np.zeros(SHAPE), np.zeros(SHAPE)
    for d in draws:
        used = d.images["mask"].values[0] & int(Mask.SATURATED) == 0
        sigma = np.sqrt(d.predicted_variance(truth[None] * TIMES[0])[0])
        total += np.where(used, (d.images["signal"].values[0] - truth * TIMES[0]) / sigma, 0.0)
        count += used
    for time in TIMES:
        full = (FULL - BIAS) / time
        for low, high in ((0.80, 0.88), (0.88, 0.96), (0.96, 1.04)):
            edge = (truth > full * low) & (truth < full * high) & (count > 0)
            if edge.any():
                samples = count[edge].sum()
                assert abs(total[edge].sum() / samples) < 4 / np.sqrt(samples) + 0.02
    assert (count[truth > 1.05 * (FULL - BIAS) / min(TIMES)] == 0).all()


def test_exposures_near_saturation_are_not_used_whether_or_not_noise_saturates_them(tmp_path):
    """Even light, four standard deviations below full scale in the longer exposure: hardly a pixel is saturated."""
    sigma = np.sqrt((FULL - BIAS) / GAIN + (READ / GAIN) ** 2)
    bands = write(tmp_path / "c", 6, times=(0.5, 2.0), light=np.full(SHAPE, (FULL - BIAS - 4 * sigma) / 2.0))
    assert bands.merged["a"].ratios.tolist() == [1.0, 4.0]
    assert np.mean(bands.merged["a"].weights[1] > 0) < 0.01


def test_the_variance_is_below_that_of_every_single_exposure(draws):
    truth = ramp() * TIMES[0]
    merged = draws[0].merged["a"]
    variance = draws[0].predicted_variance(truth[None])[0]
    assert merged.ratios.tolist() == [1.0, 0.25, 4.0]
    np.testing.assert_allclose(np.sum(merged.weights * merged.ratios[:, None, None], axis=0), 1.0)
    for index, ratio in enumerate(merged.ratios):
        alone = ((READ / GAIN) ** 2 + 1 / 12 + truth * ratio / GAIN) / ratio**2
        used = merged.weights[index] > 0
        assert (variance[used] < 1.15 * alone[used]).all()  # 1.15: the noise of eight darks, weighted too
    # the darkest pixels gain the longest exposure, the brightest are seen at all
    assert variance[0, 0] < ((READ / GAIN) ** 2) / 12


def test_a_pixel_saturated_in_its_own_band_is_measured_by_its_bracket(draws):
    truth = ramp() * TIMES[0]
    beyond = (truth > 1.2 * FULL) & (truth < 2.4 * FULL)
    mask = draws[0].images["mask"].values[0]
    assert beyond.any() and not (mask[beyond] & int(Mask.SATURATED)).any()


@pytest.mark.parametrize(("index", "true"), [(2, 2.4), (1, 0.1), (2, 1.0)])
def test_a_wrong_exposure_time_is_named_and_left_out(tmp_path, index, true):
    times = list(TIMES)
    times[index] = true
    bands = write(tmp_path / "c", 3, true_times=times, light=ramp(20, 800))
    (suspicion,) = check_brackets(bands)
    assert f"{TIMES[index]:g} s are stated" in suspicion.why and "left out" in suspicion.why
    (finding,) = bands.exposure_findings
    assert finding.index == index and abs(finding.fitting_s / true - 1) < 0.03
    assert len(bands.merged["a"].tables) == 2


def test_two_exposures_that_disagree_are_not_merged(tmp_path):
    bands = write(tmp_path / "c", 4, times=(0.5, 2.0), true_times=(0.5, 1.0), light=ramp(20, 400))
    (suspicion,) = check_brackets(bands)
    assert "not merged" in suspicion.why and not bands.merged


@pytest.mark.parametrize("offset_s", [0.0, 0.03])
def test_a_shutter_open_longer_is_no_wrong_statement(tmp_path, offset_s):
    bands = write(tmp_path / "c", 5, light=ramp(20, 800), offset_s=offset_s)
    assert not bands.exposure_findings and len(bands.merged["a"].tables) == 3


def test_brackets_at_another_aperture_are_not_merged(tmp_path):
    write(tmp_path / "c", 6, times=(0.5, 2.0))
    path = tmp_path / "c" / "capture.toml"
    path.write_text(path.read_text().replace('[[bracket]]\nband = "a"', '[[bracket]]\nband = "a"\nf_number = 16.0'))
    assert not corrected(tmp_path / "c").merged


def series(generator, true_times, times, light=None):
    """Exposures of a field without files, as ``exposures_of`` returns them."""
    light, exposures = ramp(20, 300 / max(times))[::4, ::4] if light is None else light, []
    for true, time in zip(true_times, times, strict=True):
        floor = (READ / GAIN) ** 2
        variance = floor + light * true / GAIN
        signal = light * true + np.sqrt(variance) * generator.standard_normal(light.shape)
        terms = np.stack([np.full(light.shape, floor), np.full(light.shape, 1 / GAIN), 0 * light])
        frames = CorrectedFrames(signal, terms, np.zeros(light.shape, bool))
        table = BracketTable(band="a", frames=("a.tif",), exposure_s=time)
        exposures.append(Exposure(table, time / times[0], frames, np.ones(light.shape, bool)))
    return exposures


def test_repeats_show_smaller_errors_and_bent_counts_are_none():
    """4 % in one of three times is named with steady repeats, not without; a bend of 6 % at full scale never is."""
    light = np.exp(np.add.outer(np.sin(np.arange(64) / 9), np.cos(np.arange(64) / 7)))
    light *= 900 / light.max()
    times, used = np.array([0.4, 0.8, 3.2]), {band: np.ones(light.shape, bool) for band in "abc"}

    def findings(error, bend, repeatability, seed):
        generator, exposures = np.random.default_rng(seed), {}
        for band in used:
            true = times * [1.0, 1.0 + error * (band == "a"), 1.0]
            plain = series(generator, true, times, light)
            exposures[band] = [
                replace(
                    each,
                    frames=replace(each.frames, signal=each.frames.signal * (1 + bend * each.frames.signal / 2900)),
                    repeatability=repeatability,
                )
                for each in plain
            ]
        return exposure_findings(exposures, used)

    for seed in range(4):
        assert [(f.band, f.index) for f in findings(0.04, 0.0, 5e-4, seed)] == [("a", 1)]
        assert not findings(0.04, 0.0, float("nan"), seed)
        assert not findings(0.0, -0.06, 5e-4, seed)
        assert not findings(0.0, 0.06, 5e-4, seed)


def test_no_false_alarm_in_two_hundred_sound_series():
    generator, alarms, deviations = np.random.default_rng(0), 0, []
    for _ in range(200):
        times = generator.choice([0.05, 0.1, 0.2, 0.4, 0.8, 1.6], int(generator.integers(2, 5)), replace=False)
        used = np.ones((16, 24), bool)
        flicker = 1 + 0.001 * generator.standard_normal(times.size)
        sound = series(generator, (times + 0.1 * times.min()) * flicker, times)
        alarms += bool(exposure_findings({"a": sound}, {"a": used}))
        wrong = times.copy()
        wrong[-1] *= generator.choice([0.5, 2.0])
        findings = exposure_findings({"a": series(generator, wrong, times)}, {"a": used})
        if times.size > 2 and times.min() > 0.15:  # of two, or of short ones, a longer shutter explains a wrong time
            deviations.append(bool(findings))
    assert alarms == 0 and len(deviations) > 10 and all(deviations)


@pytest.mark.filterwarnings("error")
def test_exposures_of_one_level_say_nothing_of_their_times():
    """No line leads from one level to level 0: a time wrong by a quarter is no finding, on a ramp it is."""
    times, used = np.array([0.4, 0.8, 1.6]), np.ones((64, 96), bool)
    wrong = times * [1.0, 1.25, 1.0]
    generator = np.random.default_rng(7)
    on_ramp = series(generator, wrong, times, ramp(20, 180))
    assert [finding.index for finding in exposure_findings({"a": on_ramp}, {"a": used})] == [1]
    flat = [
        replace(exposure, frames=replace(exposure.frames, signal=np.full(used.shape, 100.0 * time)))
        for exposure, time in zip(on_ramp, wrong, strict=True)
    ]
    assert not exposure_findings({"a": flat}, {"a": used})
