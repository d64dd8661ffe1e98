"""Files of frames as cameras and their programs write them."""

import numpy as np
import pytest
import tifffile

BAYER = ("RG", "GB")
XTRANS = ("GBGGRG", "RGRBGB", "GBGGRG", "GRGGBG", "BGBRGR", "GRGGBG")


def write_fits(path, image, **header):
    """A FITS image or cube whose first row is at the bottom, unless the header says TOP-DOWN."""
    fits = pytest.importorskip("astropy.io.fits", reason="needs astropy (extra 'readers')")
    # counts above 32767 take the offset that FITS uses for unsigned numbers
    rows = image if header.get("ROWORDER") == "TOP-DOWN" else image[..., ::-1, :]
    unit = fits.CompImageHDU if path.suffix == ".fz" else fits.PrimaryHDU
    unit(rows, fits.Header(header)).writeto(path)


def write_dng(path, image, exposure=(1, 4), rows=BAYER, white=4095, masked_columns=0, black=0):
    """The fewest tags by which LibRaw knows a DNG, with a mosaic of any repeat, and masked columns on the left."""
    pytest.importorskip("rawpy", reason="needs rawpy (extra 'readers')")
    matrix = [number for value in np.eye(3).ravel() for number in (int(value * 10000), 10000)]
    colours = bytes("RGB".index(letter) for letter in "".join(rows))
    tags = [
        (33421, "H", 2, (len(rows), len(rows[0])), True),
        (33422, "B", len(colours), tuple(colours), True),
        (50706, "B", 4, (1, 4, 0, 0), True),
        (50707, "B", 4, (1, 1, 0, 0), True),
        (50708, "s", 5, "Test", True),
        (50721, 10, 9, tuple(matrix), True),
        (50717, "H", 1, white, True),
        (50714, "H", 1, black, True),
        (50778, "H", 1, 21, True),
        (50728, 5, 3, (1,) * 6, True),
        (33434, 5, 1, exposure, True),
        (33437, 5, 1, (8, 1), True),
        (271, "s", 5, "Test", True),
        (272, "s", 5, "Test", True),
    ]
    if masked_columns:
        tags.append((50829, "I", 4, (0, masked_columns, *image.shape), True))
    tifffile.imwrite(path, image, photometric=32803, extratags=tags, metadata=None, subfiletype=0)


def shifted(rows, down, right):
    """The rows of a mosaic whose first pixel is ``down`` and ``right`` of that of ``rows``."""
    return tuple("".join(row) for row in np.roll([list(row) for row in rows], (-down, -right), (0, 1)))
