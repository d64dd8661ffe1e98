"""Stock settings of renderers: paths cut short and a wide filter at once."""

from cboxlab.scenes import cornell_box, cornell_camera
from cboxlab.validation.compare_renders.regress import View, regress_pictures
from pictures import SIZE, noisy, rendered
from scipy.ndimage import gaussian_filter


def test_cycles_settings_are_named_as_such():
    view = View(cornell_box(), cornell_camera(SIZE), scene_stated=True)
    stock = gaussian_filter(rendered(5)[0], (0.4, 0.4, 0))
    first = regress_pictures(noisy(1, noise=0.01), noisy(2, stock, noise=0.01), view).changes[0]
    assert (first.change, first.fits) == ("stock-settings", True)
    assert first.parameters["renderer"] == "Blender Cycles"
