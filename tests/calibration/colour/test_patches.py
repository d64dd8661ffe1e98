"""Reflectances of a chart's patches, through the whole chain."""

import numpy as np
import tifffile
from cboxlab.calibration.capture.capture import load_capture
from cboxlab.calibration.capture.mosaic import channel_mask
from cboxlab.calibration.result.calibrate import calibrate_capture
from PIL import Image


def test_chart_of_known_reflectances_through_the_whole_chain(tmp_path):
    """Patches under uneven light behind a mosaic, with stray light in one band: reflectances return.

    8 patches of 32 x 32 px, 3 bands, 5 e-/DN; the darkest patch is neutral, the white one known.
    """
    rng = np.random.default_rng(21)
    height, width, pattern = 80, 160, "RGGB"
    true = np.array([rng.uniform(0.1, 0.8, 3) for _ in range(8)])
    true[0], true[7] = 0.9, 0.04
    labels = np.zeros((height, width), np.uint8)
    scene = np.full((3, height, width), 0.2)
    for index in range(8):
        window = np.s_[4 + 38 * (index // 4) : 36 + 38 * (index // 4), 4 + 40 * (index % 4) : 36 + 40 * (index % 4)]
        labels[window] = index + 1
        scene[(slice(None), *window)] = true[index][:, None, None]
    u = np.indices((height, width))[1] / width
    folder = tmp_path / "chart"
    (folder / "frames").mkdir(parents=True)
    text = 'format = "capture/1"\n[camera]\nwidth_px = 160\nheight_px = 80\n'
    text += "bit_depth = 12\ngain_e_per_dn = 5.0\n"
    text += f'[mosaic]\npattern = "{pattern}"\n'
    stray = (0.0, 0.0, 0.05)
    for band, (name, channel) in enumerate((("f450", "B"), ("f550", "G"), ("f620", "R"))):
        light = 3000 * np.exp(-(0.3 + 0.2 * band) * u)
        signal = np.where(channel_mask(pattern, (height, width), channel), light * (scene[band] + stray[band]), 30)
        counts = np.rint(rng.poisson(5 * signal) / 5).astype(np.uint16)
        tifffile.imwrite(folder / f"frames/{name}.tif", counts)
        text += f'[[band]]\nid = "{name}"\nexposure_s = 1.0\nframes = ["frames/{name}.tif"]\n'
        text += f'transmittance = "filters.csv:{name}"\n'
    grid = np.arange(400, 701)
    bells = [np.exp(-0.5 * ((grid - c) / 5) ** 2) for c in (450, 550, 620)]
    np.savetxt(
        folder / "filters.csv",
        np.column_stack([grid, *bells]),
        delimiter=",",
        comments="",
        header="wavelength_nm,f450,f550,f620",
    )
    (folder / "known.csv").write_text("wavelength_nm,w\n400,0.9\n700,0.9\n")
    Image.fromarray(labels).save(folder / "labels.png")
    names = "".join(f"{i + 1},{'white' if i == 0 else f'p{i}'},{'w' if i == 0 else ''}\n" for i in range(8))
    (folder / "names.csv").write_text("label,name,column\n" + names)
    text += '[labels]\nimage = "labels.png"\nnames = "names.csv"\nreflectance = "known.csv"\n'
    (folder / "capture.toml").write_text(text)
    table = calibrate_capture(load_capture(folder)).patches
    # Stray light in proportion to the light at the patch is what the offset can describe.
    np.testing.assert_allclose(table.offset, stray, atol=0.006)
    np.testing.assert_allclose(table.reflectance, true, atol=0.015)
    assert np.mean(np.abs(table.reflectance - true)) < 0.005
    # The white patch: the shot noise of 256 pixels with about 12,000 electrons is 0.06 %, the light's shape adds to it.
    assert np.all((table.sigma[0] > 0.0004) & (table.sigma[0] < 0.0015))
