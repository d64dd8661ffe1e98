"""Radiance pictures and OME-TIFF stacks as programs write them: read as they are meant, or refused in one line."""

import numpy as np
import pytest
import tifffile
from cboxlab.calibration.frame_readers import frame_header, read_pictures, read_values
from cboxlab.utils.errors import InputError
from helpers.files.rgbe import write_rgbe

RGB = np.random.default_rng(3).uniform(0.05, 4.0, (9, 12, 3))
STACK = np.random.default_rng(4).integers(0, 65535, (4, 20, 24)).astype(np.uint16)

#: By what a program wrote into the header, the factor by which the values of light are larger than the stored ones.
HEADERS = {
    "nothing": ("", 1.0),
    "an exposure, as pfilt writes it": ("EXPOSURE=2.500000e-01\n", 4.0),
    "two exposures, which multiply": ("EXPOSURE=4\npfilt -e 2\nEXPOSURE= 0.5\n", 0.5),
    "comments and the commands of a renderer": ("# made by a test\nrpict -vp 0 0 0 box.oct\nSOFTWARE=a b\n", 1.0),
    "a correction of the colours": ("COLORCORR=0.5 1 2\n", np.array([2.0, 1.0, 0.5])),
    "a view and primaries": ("VIEW= -vtv -vh 39\nPRIMARIES=0.64 0.33 0.3 0.6 0.15 0.06 0.333 0.333\n", 1.0),
}


@pytest.mark.parametrize("name", HEADERS)
def test_values_of_a_radiance_picture_are_those_of_light(tmp_path, name):
    """Its header states by what the light was multiplied; eight bits leave an error of 1/128 of the largest channel."""
    header, factor = HEADERS[name]
    path = write_rgbe(tmp_path / "a.hdr", RGB, header)
    assert frame_header(path).bands == ("R", "G", "B")
    values = np.moveaxis(read_values(path), 0, -1)
    np.testing.assert_allclose(values, factor * RGB, atol=np.max(factor) * RGB.max() / 120)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"-Y 9 +X 12", b"+Y 9 +X 12", "turned rows"),
        (b"-Y 9 +X 12", b"-Y 9 -X 12", "turned rows"),
        (b"_rgbe", b"_xyze", "X, Y, Z in place of colours"),
        (b"#?RADIANCE", b"RADIANCE", "does not begin with"),
        (b"EXPOSURE=1", b"EXPOSURE=0", "EXPOSURE"),
    ],
)
def test_what_would_be_read_wrongly_is_refused(tmp_path, old, new, message):
    path = write_rgbe(tmp_path / "a.hdr", RGB, "EXPOSURE=1\n")
    path.write_bytes(path.read_bytes().replace(old, new, 1))
    with pytest.raises(InputError, match=message) as fault:
        read_values(path)
    assert "\n" not in str(fault.value)


#: By program, how it writes four pictures of one exposure.
OME = {
    "times": {"metadata": {"axes": "TYX"}},
    "depths of one place": {"metadata": {"axes": "ZYX"}},
    "one channel of several times": {"metadata": {"axes": "TCYX"}, "one_channel": True},
    "tiles, packed, with the bytes of a Macintosh": {
        "metadata": {"axes": "TYX"},
        "tile": (16, 16),
        "compression": "zlib",
        "byteorder": ">",
    },
    "a large file with names and times": {
        "metadata": {"axes": "TYX", "Plane": {"ExposureTime": [0.5] * 4}, "Channel": {"Name": ["550 nm"]}},
        "bigtiff": True,
    },
}


@pytest.mark.parametrize("name", OME)
def test_pictures_of_an_ome_stack_are_repeats(tmp_path, name):
    options = dict(OME[name])
    stack = STACK[:, None] if options.pop("one_channel", False) else STACK
    tifffile.imwrite(tmp_path / "a.ome.tif", stack, photometric="minisblack", ome=True, **options)
    assert frame_header(tmp_path / "a.ome.tif").pictures == 4
    np.testing.assert_array_equal(read_pictures(tmp_path / "a.ome.tif"), STACK)


def test_smaller_copies_in_an_ome_stack_are_no_repeats(tmp_path):
    """A pyramid, as slide scanners write it."""
    with tifffile.TiffWriter(tmp_path / "a.ome.tif", ome=True) as file:
        file.write(STACK, photometric="minisblack", subifds=1, metadata={"axes": "TYX"})
        file.write(STACK[:, ::2, ::2], photometric="minisblack", subfiletype=1)
    np.testing.assert_array_equal(read_pictures(tmp_path / "a.ome.tif"), STACK)


@pytest.mark.parametrize("axes", ["CYX", "TCYX"])
def test_channels_of_an_ome_stack_are_asked_for_one_by_one(tmp_path, axes):
    stack = STACK if axes == "CYX" else STACK.reshape(2, 2, 20, 24)
    tifffile.imwrite(tmp_path / "a.ome.tif", stack, photometric="minisblack", ome=True, metadata={"axes": axes})
    with pytest.raises(InputError, match=r"\d channels in the stack; expected one channel"):
        read_pictures(tmp_path / "a.ome.tif")
