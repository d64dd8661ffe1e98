"""A small excess without any rendering: two surfaces in three bands, noise, and a cause of the test's own."""

import numpy as np
from cboxlab.validation.diagnose.field_fit import ResidualData, Transport
from scipy.sparse import csr_array

SIZE, BANDS = 48, 4
ROWS, COLUMNS = np.indices((SIZE, SIZE))
FLOOR = ROWS >= 30

#: DN of the sound picture, with steps that blurs and displacements move.
DIAMOND = abs(COLUMNS - 18) + abs(ROWS - 20) < 11
PICTURE = (1000.0 + 4 * COLUMNS) * np.where(FLOOR, 0.8, 1.3) * np.where(DIAMOND, 0.7, 1.0)
SIGNAL = np.array([1.0, 0.8, 1.2, 0.6])[:, None, None] * PICTURE
EXPOSURE_S = np.array([1.0, 2.0, 8.0, 3.0])

#: What a coat would mirror, relative to the lamp's radiance: reddish towards the right, bluish towards the left.
COAT = 0.4 * (0.5 + np.array([-0.3, -0.1, 0.1, 0.3])[:, None, None] * (COLUMNS - 24) / 24)

#: Cosines towards camera and lamp: different functions of the place on either surface.
VIEW = np.where(FLOOR, 0.2 + 0.01 * (ROWS - 30), 0.95 - 0.3 * ((COLUMNS - 24) / 24) ** 2)
INCIDENCE = np.where(FLOOR, 0.95 - 0.3 * ((COLUMNS - 24) / 24) ** 2, 0.25 + 0.02 * ROWS)
EMISSION = np.where(FLOOR, 0.6 + 0.008 * COLUMNS, 0.3 + 0.01 * ROWS)
#: Place on the lamp from which light comes: the wall's columns see either end, the floor's rows either side.
SIDE = np.stack([np.where(FLOOR, 0.1, (COLUMNS - 24) / 60), np.where(FLOOR, (ROWS - 39) / 20, 0.1)], axis=-1)
SIGMA = 0.01 * SIGNAL.mean() * np.ones(SIGNAL.shape)


def small_excess(change, repeats=None, seed=3):
    """The residual that a change (band, y, x) in DN and noise leave; only a lamp's scale is adjusted next to it."""
    noise = np.random.default_rng(seed).standard_normal(SIGNAL.shape)
    lamp = SIGNAL / SIGMA / np.linalg.norm(SIGNAL / SIGMA)
    residual = noise + change / SIGMA
    residual = residual - lamp * np.sum(lamp * residual)
    down, right = np.gradient(SIGNAL, axis=(1, 2))
    surface = np.where(FLOOR, 0, 1)
    position = np.stack([COLUMNS, np.where(FLOOR, 0, 30 - ROWS), np.where(FLOOR, ROWS - 30, 0)], axis=-1) * 10.0
    patches = np.array([[100.0, 0, 50], [300, 0, 50], [100, 150, 0], [300, 150, 0]])
    values = np.ones((SIZE * SIZE, BANDS))
    transport = Transport(
        pixel=np.arange(SIZE * SIZE),
        coverage=np.ones(SIZE * SIZE),
        surface=surface.ravel(),
        material=surface.ravel(),
        position=position.reshape(-1, 3),
        gather=csr_array(np.full((SIZE * SIZE, 4), 0.05, np.float32)),
        patch_surface=np.array([0, 0, 1, 1]),
        patch_material=np.array([0, 0, 1, 1]),
        patch_position=patches,
        form_factors=np.full((4, 4), 0.05, np.float32),
        reflectance=np.array([[0.5] * BANDS, [0.7] * BANDS]),
        arriving=values,
        direct=0.8 * values,
        view=VIEW.ravel(),
        incidence=INCIDENCE.ravel(),
        patch_arriving=np.ones((4, BANDS)),
        patch_direct=np.full((4, BANDS), 0.8),
        patch_incidence=np.array([0.7, 0.9, 0.4, 0.6]),
        emission=EMISSION.ravel(),
        patch_emission=np.array([0.7, 0.9, 0.4, 0.6]),
        side=SIDE.reshape(-1, 2),
        patch_side=np.array([[0.1, -0.2], [0.1, -0.2], [-0.23, 0.1], [0.1, 0.1]]),
        picture=SIGNAL / 1000,
        line_nm=np.array([440.0, 540.0, 640.0]),
        lines=np.array([np.where(COLUMNS > edge, 1.5, 0.5) for edge in (12, 24, 36)]) * SIGNAL[0] / 1000,
        roughness=(0.1,),
        coats=COAT[None].astype(np.float32),
    )
    return ResidualData(
        residual=residual.astype(np.float32),
        marginal_residual=residual,
        used=np.ones(SIGNAL.shape, bool),
        sigma=SIGMA,
        signal=SIGNAL,
        noise=np.zeros(SIGNAL.shape),
        nuisances=lamp[..., None],
        num_free_nuisances=1,
        moved=-np.array([right, down], np.float32),
        flat=np.ones(SIGNAL.shape),
        surface=surface,
        names=("floor", "wall"),
        materials=("grey", "pale"),
        bands=("b0", "b1", "b2", "b3"),
        nm=np.array([450.0, 520, 590, 660]),
        minutes=np.array([2.0, 0, 1, 3]),
        exposure_s=EXPOSURE_S,
        flat_exposure_s=np.full(BANDS, 4.0),
        repeats=np.zeros((BANDS, 2)) if repeats is None else repeats,
        repeat_sigma=np.full(BANDS, 1e-4),
        transport=transport,
    )
