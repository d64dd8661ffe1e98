"""Hidden effects: as strong as asked for, in laboratories that vary, effects of light transport included."""

from dataclasses import replace

import numpy as np
import pytest
from cboxlab.rendering.device.variant import compiled
from cboxlab.rendering.effects import apply_checked
from cboxlab.rendering.model.model_file import Model, load_model, write_model
from cboxlab.rendering.synthetic import CaptureSettings, band_filters
from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.validation.synthetic.blind import draw_effect
from cboxlab.validation.synthetic.strengths import at_strength, scale_of
from cboxlab.validation.synthetic.varied import varied_settings, with_block_offsets

BANDS = tuple(band_filters())


def test_the_distance_from_null_is_scaled_until_the_strength_is_reached():
    """Chi2 that grows with the square of the amplitude: the answer is known."""
    weak = apply_checked("block-pose", {"dx_mm": 1.0, "dz_mm": -0.5, "yaw_deg": 0.1}, "test")
    scaled = at_strength(weak, 8.0, lambda e: 0.02 * float(e.values["dx_mm"]) ** 2)
    assert scaled is not None
    assert scaled.values["dx_mm"] == pytest.approx(20.0, rel=0.02)
    assert scaled.values["dz_mm"] == pytest.approx(-0.5 * scaled.values["dx_mm"])
    assert scaled.values["yaw_deg"] == pytest.approx(0.1 * scaled.values["dx_mm"])
    less = at_strength(scaled, 0.06, lambda e: 0.02 * float(e.values["dx_mm"]) ** 2)
    assert less is not None and less.values["dx_mm"] == pytest.approx(np.sqrt(3), rel=0.02)
    assert at_strength(weak, 8.0, lambda e: 1e-6 * float(e.values["dx_mm"]) ** 2) is None


@pytest.mark.skipif(not compiled(), reason="needs LLVM 16 or newer")
def test_strength_grows_with_the_square_of_an_effect_and_holds_no_noise_of_its_pictures():
    """An offset's chi2 is its square's to rounding. A block's small motion changes pixels by less than their rays'
    noise: of a tenth of a motion a hundredth is left, to which squares would add their noise."""
    scale = scale_of(Model(), cornell_camera(32), CaptureSettings(), 5)
    weak, two = (scale(apply_checked("dark-offset", {"dn": dn}, "test")) for dn in (0.3, 0.6))
    assert weak > 0 and two / weak == pytest.approx(4.0, rel=2e-3)
    far, near = (scale(apply_checked("block-pose", {"block": "tall", "dx_mm": dx}, "test")) for dx in (3.0, 0.3))
    assert near / far == pytest.approx(1 / 100, rel=0.3)


def test_an_index_is_scaled_in_the_square_of_its_inverse():
    shift = apply_checked("filter-shift", {"effective_index": 2.0}, "test")
    scaled = at_strength(shift, 1.0, lambda e: 100 * float(e.values["effective_index"]) ** -4)
    assert scaled is not None
    assert scaled.values["effective_index"] == pytest.approx(100**0.25, rel=0.01)


def test_interreflection_is_drawn_only_where_it_is_named():
    generator = np.random.default_rng(0)
    members = {draw_effect(generator, cornell_box(), BANDS).id for _ in range(300)}
    assert "interreflection" not in members
    assert {"gloss", "haze", "fluorescence", "rough-diffuse", "ambient-light"} <= members
    assert draw_effect(generator, cornell_box(), BANDS, ("interreflection",)).values == {"max_bounces": np.inf}


def test_laboratories_vary_by_seed_and_repeat():
    assert varied_settings(1) == varied_settings(1)
    assert varied_settings(1) != varied_settings(2)
    assert varied_settings(1).full_scale_dn == CaptureSettings().full_scale_dn
    moved = np.concatenate(
        [
            (
                with_block_offsets(cornell_box(), seed).surface("tall-block").vertices_mm
                - cornell_box().surface("tall-block").vertices_mm
            )
            for seed in range(20)
        ]
    )
    assert 0.05 < np.abs(moved[:, [0, 2]]).max() < 1.0 and np.allclose(moved[:, 1], 0, atol=1e-9)


def test_a_models_uncertainties_survive_its_file(tmp_path):
    effect = replace(apply_checked("ghost", {"fraction": 0.01}, "test"), sigma={"fraction": 1e-4})
    write_model(tmp_path / "m.toml", Model().with_effect(effect))
    back = load_model(tmp_path / "m.toml").effects[0]
    assert back.values == effect.values and back.sigma == {"fraction": 1e-4}
