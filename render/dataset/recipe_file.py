"""Recipe of a file, with its names, sources and sums checked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cboxlab.utils.errors import InputError
from cboxlab.utils.faults import combined, suggestion, validated, value_text
from cboxlab.utils.input_files import read_toml
from cboxlab.utils.limits import MAX_CUBE_VALUES

from ..effects import apply_checked
from ..model import named_effect
from .distributions import numbers
from .light_parts import REFLECTIONS
from .paints import light_source, reflectance_source
from .patterns import MOST_BLOCK_TILES, image_tiles
from .recipe import ANY, TRUTHS, WALLS, BlockTable, EffectTable, PatternTable, Recipe, TextureTable
from .solids import closed_mesh
from .textures import image_shares

__all__ = ["load_recipe"]


def load_recipe(path: Path) -> Recipe:
    """Recipe of a file.

    Parameters
    ----------
    path
        TOML file. Tables of spectra that it names are relative to its folder.

    Returns
    -------
    Recipe
        The recipe, with its names checked.

    Raises
    ------
    InputError
        If the file is missing or faulty; one error lists all faults of its keys.
    """
    content = read_toml(path, "a recipe in TOML", "docs/how-to/data-set.md describes it")
    recipe = validated(path, content, Recipe)
    faults = _faults(path, recipe)
    if faults:
        raise combined(faults)
    return recipe


def _faults(path: Path, recipe: Recipe) -> list[InputError]:
    """Faults of names, sources and sums of a recipe."""
    faults = []
    if missing := [wall for wall in WALLS if wall not in recipe.walls]:
        faults.append(InputError(f"{path}: walls", f"no {', no '.join(missing)}", f"all of {', '.join(WALLS)}"))
    paints, smooth = list(recipe.paint), [*recipe.paint, *recipe.texture]
    users = [
        (f"walls.{wall}", choice.names, smooth if wall == "ceiling" else [*smooth, *recipe.pattern])
        for wall, choice in recipe.walls.items()
    ]
    users += [
        (f"block[{index}].paint", block.paint.names, [*smooth, *recipe.pattern] if block.shape == "box" else smooth)
        for index, block in enumerate(recipe.block)
    ]
    for name, texture in recipe.texture.items():
        users.append((f"texture.{name}.paints", tuple(texture.paints), paints))
        faults += _texture_faults(f"{path}: texture.{name}", name, texture, recipe, path.parent)
    for name, pattern in recipe.pattern.items():
        users.append((f"pattern.{name}.paints", tuple(pattern.paints), paints))
        faults += _pattern_faults(f"{path}: pattern.{name}", name, pattern, recipe, path.parent)
    for index, block in enumerate(recipe.block):
        faults += _mesh_faults(f"{path}: block[{index}]", block, path.parent)
        faults += _tile_faults(f"{path}: block[{index}].paint", block, recipe, path.parent)
    for key, listed, allowed in users:
        for name in listed:
            if name not in allowed:
                expected = f"one of {', '.join(allowed)}"
                faults.append(InputError(f"{path}: {key}", f"'{name}'", expected, suggestion(name, allowed)))
    for index, truth in enumerate(recipe.picture.truths):
        if truth not in TRUTHS:
            where = f"{path}: picture.truths[{index}]"
            faults.append(InputError(where, f"'{truth}'", f"one of {', '.join(TRUTHS)}", suggestion(truth, TRUTHS)))
    p = recipe.picture
    if not 2 <= (p.last_nm - p.first_nm) / p.step_nm + 1 < 2000:
        grid = f"{p.first_nm:g} to {p.last_nm:g} nm by {p.step_nm:g} nm"
        faults.append(InputError(f"{path}: picture", grid, "2 to 2000 wavelengths, ascending"))
    else:
        faults += _size_faults(path, recipe)
    total = recipe.parts.train + recipe.parts.validation + recipe.parts.test
    if abs(total - 1) > 1e-9:
        faults.append(InputError(f"{path}: parts", f"shares of sum {total:g}", "shares of sum 1"))
    for kind, tables in (("camera", recipe.camera), ("sensor", recipe.sensor)):
        names = [table.name for table in tables]
        if len(set(names)) < len(names):
            faults.append(InputError(f"{path}: {kind}", f"names {', '.join(names)}", "each name once"))
    faults += [fault for fault in _source_faults(path, recipe) if fault is not None]
    for index, entry in enumerate(recipe.effect):
        faults += _effect_faults(f"{path}: effect[{index}]", entry, recipe, path.parent)
    return faults


def _size_faults(path: Path, recipe: Recipe) -> list[InputError]:
    """Faults of pictures whose largest array no reader of cubes accepts."""
    faults, p = [], recipe.picture
    parts = len(REFLECTIONS) if "reflections" in p.truths else 1
    for index, camera in enumerate(recipe.camera):
        values = camera.width_px * camera.height_px * p.wavelength_nm.size * parts
        if values > MAX_CUBE_VALUES:
            size = f"a picture with an array of {values} values"
            hint = "Make it smaller, or leave 'reflections' out of the truths."
            faults.append(InputError(f"{path}: camera[{index}]", size, f"at most {MAX_CUBE_VALUES}", hint))
    return faults


def _mesh_faults(where: str, block: BlockTable, folder: Path) -> list[InputError]:
    """Faults of the mesh of a block."""
    if (block.shape == "mesh") != (block.mesh is not None):
        excess = "without a mesh" if block.mesh is None else "with a mesh"
        return [InputError(where, f"the shape '{block.shape}' {excess}", "mesh = FILE for the shape 'mesh' alone")]
    if block.mesh is not None:
        try:
            closed_mesh(block.mesh, folder, f"{where}.mesh")
        except InputError as fault:
            return [fault]
    return []


def _pattern_faults(where: str, name: str, pattern: PatternTable, recipe: Recipe, folder: Path) -> list[InputError]:
    """Faults of a pattern."""
    if faults := _table_faults(where, name, pattern, recipe):
        return faults
    if pattern.image is not None:
        try:
            image_tiles(pattern.image, len(pattern.paints), folder, f"{where}.image")
        except InputError as fault:
            return [fault]
    return []


def _texture_faults(where: str, name: str, texture: TextureTable, recipe: Recipe, folder: Path) -> list[InputError]:
    """Faults of a texture."""
    if faults := _table_faults(where, name, texture, recipe):
        return faults
    if name in recipe.pattern:
        return [InputError(where, f"'{name}', the name of a pattern", "another name")]
    if texture.image is not None:
        try:
            image_shares(texture.image, folder, f"{where}.image")
        except InputError as fault:
            return [fault]
    return []


def _table_faults(where: str, name: str, table: PatternTable | TextureTable, recipe: Recipe) -> list[InputError]:
    """Faults of the name, the paints and the image of a pattern or texture."""
    if name in recipe.paint:
        return [InputError(where, f"'{name}', the name of a paint", "another name")]
    if len(set(table.paints)) < len(table.paints):
        return [InputError(f"{where}.paints", ", ".join(table.paints), "each paint once")]
    if (table.kind == "image") != (table.image is not None):
        excess = "without an image" if table.image is None else "with an image"
        return [InputError(where, f"the kind '{table.kind}' {excess}", "image = FILE for the kind 'image' alone")]
    return []


def _tile_faults(where: str, block: BlockTable, recipe: Recipe, folder: Path) -> list[InputError]:
    """Faults of patterns with too many tiles for a block."""
    faults = []
    for name in block.paint.names:
        if (pattern := recipe.pattern.get(name)) is None:
            continue
        if pattern.image is None:
            most = max(pattern.rows.support[1], pattern.columns.support[1])
        else:
            try:
                most = max(image_tiles(pattern.image, len(pattern.paints), folder, where).shape)
            except InputError:
                continue  # a fault of the pattern
        if most > MOST_BLOCK_TILES:
            expected = f"at most {MOST_BLOCK_TILES} along an edge of a block"
            faults.append(InputError(where, f"the pattern '{name}' of up to {most:g} tiles", expected))
    return faults


def _effect_faults(where: str, entry: EffectTable, recipe: Recipe, folder: Path) -> list[InputError]:
    """Faults of an effect, of the ends of its distributions, and of its materials' names.

    Names of surfaces and blocks are checked in each box.
    """
    lists = {name: value if isinstance(value, list) else [value] for name, value in entry.parameters.items()}
    names = {name: texts for name, texts in lists.items() if texts and all(isinstance(text, str) for text in texts)}
    ends: list[dict[str, Any]] = [{} for _ in range(max([2, *map(len, names.values())]))]
    for name, value in entry.parameters.items():
        if name in names:
            for number, end in enumerate(ends):
                end[name] = names[name][min(number, len(names[name]) - 1)]
            continue
        try:
            low_and_high = numbers(value).support
        except ValueError as fault:
            return [InputError(f"{where}.{name}", value_text(value), str(fault))]
        for number, end in enumerate(ends):
            end[name] = low_and_high[number % 2]
    try:
        effect = named_effect(entry.id, folder)
        for end in ends:
            applied = apply_checked(effect, end, where, {"material": [*recipe.paint, *recipe.texture, ANY]})
    except InputError as fault:
        return [fault]
    if applied.stage == "transport" and recipe.texture:
        excess = f"'{entry.id}', an effect on light transport, in a recipe with textures"
        hint = "Make a second data set with the effect, or take patterns."
        return [InputError(f"{where}.id", excess, "effects on scene, camera, filters or counts", hint)]
    return []


def _source_faults(path: Path, recipe: Recipe) -> list[InputError | None]:
    """Faults of the sources of spectra."""

    def fault(where: str, read: Any, name: str) -> InputError | None:
        try:
            read(name, path.parent, f"{path}: {where}")
        except InputError as error:
            return error
        return None

    faults = [
        fault(f"paint.{name}.reflectance", reflectance_source, source)
        for name, paint in recipe.paint.items()
        for source in paint.reflectance.names
    ]
    for index, lamp in enumerate(recipe.lamp):
        where = f"lamp[{index}]"
        faults += [fault(f"{where}.spectrum", light_source, source) for source in lamp.spectrum.names]
        if ("planck" in lamp.spectrum.names) != (lamp.temperature_k is not None):
            excess = "no temperature" if lamp.temperature_k is None else "a temperature without the spectrum 'planck'"
            expected = "a distribution of temperatures where spectrum lists 'planck', none elsewhere"
            faults.append(InputError(f"{path}: {where}.temperature_k", excess, expected))
    return faults
