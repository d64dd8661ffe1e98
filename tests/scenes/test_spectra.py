"""Spectra: linear between samples, stated behaviour outside the table, and readers that help."""

import numpy as np
import pytest
from cboxlab.scenes import Spectrum, read_spectra, read_spectrum
from cboxlab.scenes.spectra import planck
from cboxlab.scenes.spectrum_checks import radiance_faults, reflectance_faults, table_faults
from cboxlab.utils.errors import InputError
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

finite = st.floats(-1e12, 1e12, allow_nan=False)
tables = st.lists(st.tuples(st.floats(1.0, 1e5), finite), min_size=1, max_size=20, unique_by=lambda row: row[0]).map(
    sorted
)


def write(folder, text, name="table.csv"):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@given(tables, st.floats(0, 1))
def test_linear_between_samples(rows, share):
    wavelength, values = (np.array(column) for column in zip(*rows, strict=True))
    spectrum = Spectrum(wavelength, values)
    assert np.array_equal(spectrum.at(wavelength), values)
    left, right = wavelength[:-1], wavelength[1:]
    between = left + share * (right - left)
    weight = (between - left) / (right - left)
    expected = (1 - weight) * values[:-1] + weight * values[1:]
    assert np.allclose(spectrum.at(between), expected, rtol=1e-9, atol=1e-9 * np.abs(values).max())


def test_outside_its_table_a_reflectance_is_held_and_a_radiance_is_zero():
    wavelength, values = np.array([400.0, 500.0, 700.0]), np.array([0.2, 0.4, 0.8])
    assert Spectrum(wavelength, values, "hold").at([1.0, 399.9, 400.0, 700.0, 701.0, 2000.0]) == pytest.approx(
        [0.2, 0.2, 0.2, 0.8, 0.8, 0.8]
    )
    light = Spectrum(wavelength, values, "zero").at([1.0, 399.9, 400.0, 450.0, 700.0, 701.0])
    assert light == pytest.approx([0, 0, 0.2, 0.3, 0.8, 0])


def test_shape_of_the_wavelengths_is_kept():
    spectrum = Spectrum(np.array([400.0, 700.0]), np.array([0.0, 3.0]))
    assert spectrum.at(550.0).shape == ()
    assert spectrum.at([[500.0], [600.0]]) == pytest.approx(np.array([[1.0], [2.0]]))
    assert spectrum.scaled(2.0).at(500.0) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("wavelength", "values"),
    [
        ([500, 400], [1, 1]),
        ([400, 400], [1, 1]),
        ([400, np.nan], [1, 1]),
        ([400, 500], [1, np.inf]),
        ([], []),
        ([400, 500], [1]),
        ([[400, 500]], [[1, 1]]),
    ],
)
def test_a_spectrum_that_is_none_is_refused(wavelength, values):
    with pytest.raises(InputError):
        Spectrum(np.array(wavelength, float), np.array(values, float))


@pytest.mark.parametrize("temperature_k", [2900.0, 6500.0])
def test_planck_obeys_wien_and_stefan_boltzmann(temperature_k):
    """Peak at 2897771.955 nm K / T; the integral over all wavelengths in units of the peak's height is fixed.

    With x = c2 / (lambda T): integral L dl = (T/c2)^4 pi^4/15 in the units where L = lambda^-5 / (e^x - 1).
    """
    wavelength = np.linspace(300, 1500, 120001)
    peak = wavelength[np.argmax(planck(wavelength, temperature_k))]
    assert peak == pytest.approx(2897771.955 / temperature_k, abs=0.02)
    assert planck(550.0, temperature_k) == pytest.approx(1.0)
    c2_nm = 0.014387769e9
    total = quad(lambda l_nm: planck(l_nm, temperature_k), 100, 1e6, limit=500)[0]
    height = 550.0**-5 / np.expm1(c2_nm / (550.0 * temperature_k))
    assert total * height == pytest.approx((temperature_k / c2_nm) ** 4 * np.pi**4 / 15, rel=1e-3)


@given(rows=tables)
def test_a_table_survives_its_file(tmp_path_factory, rows):
    text = "\n".join(["wavelength_nm,a", *(f"{w!r},{v!r}" for w, v in rows)])
    spectrum = read_spectrum(write(tmp_path_factory.mktemp("csv"), text).parent, "table.csv:a")
    assert np.array_equal(np.column_stack([spectrum.wavelength_nm, spectrum.values]), np.array(rows))


@given(
    st.one_of(
        st.binary(max_size=200),
        st.text(max_size=200).map(lambda text: text.encode("utf-8", "surrogatepass")),
        st.text("0123456789.,-e\n\"'nai \r\0", max_size=80).map(lambda text: b"wavelength_nm,a\n" + text.encode()),
    )
)
def test_garbage_is_an_input_error_or_a_sound_table(tmp_path_factory, content):
    path = write(tmp_path_factory.mktemp("csv"), content)
    try:
        spectra = read_spectra(path)
    except InputError as error:
        assert str(path) in str(error)
    else:
        assert all(np.all(np.diff(s.wavelength_nm) > 0) and np.all(np.isfinite(s.values)) for s in spectra.values())


@pytest.mark.parametrize(
    ("text", "phrases"),
    [
        ("wavelength_nm,a\n400,0.1\n410,nan\n", "line 3, a"),
        ("wavelength_nm,a\n400,0.1\n\n410,x\n", "line 4, a"),
        ("wavelength_nm,a\n500,0.1\n400,0.1\n", "400 after 500"),
        ("wavelength_nm,a\n500,0.1\n500,0.1\n", "500 after 500"),
        ("wavelength_nm,a\n500\n", "1 cells"),
        ("wavelength_nm,a,a\n500,1,1\n", "header"),
        ("channel,a\n500,1\n510,1\n", "wavelength_nm"),
        ("wavelength,a\n5000,1\n5100,1\n", "without a unit"),
        ("wavelength_nm,a\n", "no table"),
        (b"\xff\xfe\x00", "UTF-8"),
        ("wavelength_nm,a\n400,1\n".encode("utf-16"), "UTF-16 text"),
        ("wavelength_nm,a\n400,1\n".encode("utf-16-le"), "UTF-16 text"),
        (b"wavelength_nm;a\n400;1\n", "at least two"),
        (b"wavelength_nm\ta\n400\t1\n500\tx", "line 3"),
    ],
)
def test_a_fault_is_reported_with_its_place(tmp_path, text, phrases):
    with pytest.raises(InputError) as error:
        read_spectra(write(tmp_path, text))
    assert phrases in str(error.value) and "table.csv" in str(error.value)


@pytest.mark.parametrize("reference", ["../out.csv:a", "/etc/hostname:a", "table.csv", "table.csv:b", "no.csv:a", ":a"])
def test_a_reference_to_nothing_inside_the_folder_is_refused(tmp_path, reference):
    folder = tmp_path / "capture"
    folder.mkdir()
    write(tmp_path, "wavelength_nm,a\n400,1\n", "out.csv")
    write(folder, "wavelength_nm,a\n400,1\n")
    with pytest.raises(InputError):
        read_spectrum(folder, reference)


def test_a_link_that_leaves_the_folder_is_refused(tmp_path):
    folder = tmp_path / "capture"
    folder.mkdir()
    (folder / "link.csv").symlink_to(write(tmp_path, "wavelength_nm,a\n400,1\n", "out.csv"))
    with pytest.raises(InputError, match="leaves the folder"):
        read_spectrum(folder, "link.csv:a")


def test_byte_order_mark_and_windows_lines_are_read(tmp_path):
    spectra = read_spectra(write(tmp_path, "\ufeffwavelength_nm, a\r\n400,1\r\n500,2\r\n"))
    assert spectra["a"].at(450.0) == pytest.approx(1.5)


def test_a_hole_is_a_step_above_three_medians():
    def spectrum(step_nm):
        return Spectrum(np.array([400.0, 410.0, 420.0, 420.0 + step_nm, 430.0 + step_nm]), np.full(5, 0.5))

    assert table_faults(spectrum(30.0), "here") == []
    (fault,) = table_faults(spectrum(30.5), "here")
    assert "420 to 450.5 nm" in str(fault) and "here" in str(fault)
    assert table_faults(Spectrum(np.array([550.0]), np.array([0.5])), "here") == []


def test_paints_reflect_between_nothing_and_everything():
    def faults(*values):
        return reflectance_faults(Spectrum(np.array([400.0, 500.0]), np.array(values)), "here")

    assert faults(0.0, 1.0) == []
    assert "1.01 at 500 nm" in str(faults(0.5, 1.01)[0])
    assert "-0.01 at 400 nm" in str(faults(-0.01, 0.5)[0])
    assert "percent" in str(faults(74.3, 81.0)[0])


def test_lamps_give_light():
    def faults(*values):
        return radiance_faults(Spectrum(np.array([400.0, 500.0]), np.array(values), "zero"), "here")

    assert faults(0.0, 8.0) == []
    assert "0 everywhere" in str(faults(0.0, 0.0)[0])
    assert "-1 at 500 nm" in str(faults(1.0, -1.0)[0])
