"""Recipes of small data sets."""

PLAIN = """
format = "dataset/1"
name = "small boxes"
boxes = 2
seed = 11
[picture]
step_nm = 100.0
noise = 0.1
[room]
width_mm = [450, 650]
[paint.light]
reflectance = ["cornell-box:white"]
[paint.colour]
reflectance = ["colorchecker", "cie-224"]
scale = [0.7, 1.0]
[walls]
floor = "light"
ceiling = "light"
back = "light"
left = "colour"
right = ["light", "colour"]
[[block]]
count = { integer = [1, 2] }
width_mm = [80, 160]
depth_mm = [80, 160]
height_mm = [80, 300]
paint = "light"
[[lamp]]
width_mm = [100, 200]
x = [0.3, 0.7]
spectrum = ["D65", "planck"]
temperature_k = [2500, 6500]
power_w = { log_uniform = [0.5, 5.0] }
[[camera]]
name = "main"
width_px = 16
height_px = 16
k1 = [-0.05, 0.05]
"""


def write_recipe(folder, *changes, text=PLAIN):
    """The plain recipe with parts of its text replaced, as a file."""
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = folder / "recipe.toml"
    path.write_text(text)
    return path
