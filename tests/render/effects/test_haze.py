"""Light in hazy air, from patches and a few cells written out as sums: what is lost on each way, what is scattered."""

import importlib

import numpy as np
import pytest
from cboxlab.rendering.perturbation import STEPS, AirTransport
from cboxlab.rendering.perturbation.haze import AirLamp
from helpers.fakes.patch_light import fake_patch_light
from helpers.fakes.stages import apply

haze = importlib.import_module("cboxlab.rendering.effects.haze")
LAMP = np.array([278.0, 548.0, 279.5])


def air_of(light):
    """Eight cells that fill the box, with numbers at random for what they see."""
    random = np.random.default_rng(8)
    size = np.array([278.0, 274.0, 280.0])
    corner = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) * size
    axes = tuple(np.array([0.5, 1.5]) * size[a] for a in range(3))
    camera = light.transport.camera
    rows, columns = np.mgrid[0 : camera.height_px, 0 : camera.width_px]
    shape = rows.shape
    return AirTransport(
        (axes,),
        -np.inf,
        corner,
        np.broadcast_to(size, (8, 3)),
        np.full(8, size.prod()),
        patch_coverage=random.uniform(0.05, 0.2, (8, 3)).astype(np.float32),
        escape=random.uniform(0.0, 0.1, 8),
        lamps=(AirLamp(random.uniform(0.0, 0.05, 8), random.uniform(0.0, 0.05, (*shape, STEPS)), LAMP),),
        depth=random.uniform(1000.0, 1400.0, shape),
        direction=camera.directions(columns, rows),
        eye_mm=camera.position_mm,
    )


@pytest.fixture
def hazy(monkeypatch):
    """The light before, its air, and a function of extinction (1/m) and albedo to the light after."""
    before = fake_patch_light().change(surround=np.array([0.02, 0.05, 0.03]))
    air = air_of(before)
    monkeypatch.setattr(haze, "air_transport", lambda transport: air)
    monkeypatch.setattr(haze, "_FRAGMENTS", 2)
    monkeypatch.setattr(haze, "_ROWS", 2)
    monkeypatch.setattr(haze, "_ROUNDS", 30)
    monkeypatch.setattr(haze, "_SETTLED", 1e-9)
    return before, air, lambda e, a: apply("haze", before, extinction_per_m=e, albedo=a)


def passed(a, b, sigma):
    return np.exp(-sigma * np.linalg.norm(a[:, None] - b[None], axis=-1))


def expected(light, air, sigma, albedo):
    """Pictures (w, y, x): patches and cells light each other until nothing changes; sigma per mm."""
    t, exchange, patches = light.transport, light.transport.light.exchange, light.transport.light.patches
    eye = t.camera.position_mm
    to_patch, to_fragment, to_cell = (
        passed(points, LAMP[None], sigma)[:, 0] for points in (patches.centre, t.position, air.centres)
    )
    direct = exchange.direct[:, 0] * to_patch
    factors = exchange.form_factors * passed(patches.centre, patches.centre, sigma)
    gather = t.gather.toarray() * passed(t.position, patches.centre, sigma)
    air_transmission = air.patch_coverage * passed(air.centres, patches.centre, sigma)
    onto = 4 * air.volume[None] * air_transmission.T / patches.area[:, None]
    between = air.between_cells(sigma)
    pictures = []
    for band, surround in enumerate(light.surround):
        rho, source, b = light.patch_reflectance[:, band], np.zeros(8), np.zeros(3)
        for _ in range(200):
            b = rho * (direct + exchange.escape * surround + factors @ b + onto @ source)
            smooth = surround * air.escape + air_transmission @ b + between @ source
            source = sigma * albedo * (air.lamps[0].cells * to_cell + smooth)
        arriving = t.direct[:, 0] * to_fragment + gather @ b + t.escape * surround
        arriving = arriving + (onto @ source)[t.face]  # each face holds one patch
        picture = np.bincount(t.pixel, t.coverage * light.fragment_reflectance[:, band] * arriving, minlength=6)
        picture = picture.reshape(t.covered.shape) + t.lamp_radiance[0] + surround * (1 - t.covered)
        picture = picture * np.exp(-sigma * air.depth)
        for step in range(STEPS):
            along = (step + 0.5) / STEPS * air.depth
            point = eye + along[..., None] * air.direction
            scattered = (air.weights_at(point) @ smooth).reshape(point.shape[:-1])
            scattered = scattered + air.lamps[0].rays[..., step] * np.exp(
                -sigma * np.linalg.norm(point - LAMP, axis=-1)
            )
            picture = picture + albedo * sigma * scattered * np.exp(-sigma * along) * air.depth / STEPS
        pictures.append(picture)
    return np.array(pictures)


@pytest.mark.parametrize(("extinction", "albedo"), [(0.4, 0.0), (0.4, 0.9), (1.5, 0.6)])
def test_the_picture_is_the_sum_over_all_ways(hazy, extinction, albedo):
    before, air, after = hazy
    picture = after(extinction, albedo).picture()
    np.testing.assert_allclose(picture, expected(before, air, extinction * 1e-3, albedo), rtol=2e-5)
    assert np.abs(picture / before.picture() - 1).max() > 0.1


def test_clear_air_changes_nothing(hazy):
    before, _, after = hazy
    assert after(0.0, 0.9) is before
