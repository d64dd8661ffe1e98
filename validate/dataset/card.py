"""Data card and Croissant record of a data set."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from cboxlab.rendering.dataset import Recipe
from cboxlab.utils.files import replacing

from .formats import MEDIA_TYPES, PICTURE_ENDINGS
from .layout import INDEX, Layout, file_hash, versions, write_json

__all__ = ["write_card", "write_croissant"]

#: Terms of Croissant 1.0 with nothing further in the context that its readers expect.
_TERMS = [
    "citeAs",
    "column",
    "equivalentProperty",
    "extract",
    "field",
    "fileObject",
    "fileProperty",
    "fileSet",
    "format",
    "includes",
    "isLiveDataset",
    "jsonPath",
    "key",
    "md5",
    "parentField",
    "path",
    "recordSet",
    "references",
    "regex",
    "repeated",
    "replace",
    "samplingRate",
    "separator",
    "source",
    "subField",
    "transform",
]

#: Context of Croissant 1.0, complete, since its readers compare it.
_CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "sc": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "dct": "http://purl.org/dc/terms/",
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    **{term: f"cr:{term}" for term in _TERMS},
}

#: Columns of the index that the record describes, with their types.
_FIELDS = {
    "picture": "sc:Integer",
    "box": "sc:Integer",
    "geometry": "sc:Integer",
    "camera": "sc:Text",
    "part": "sc:Text",
    "file": "sc:Text",
    "relative_standard_error": "sc:Float",
    "mean_luminance": "sc:Float",
    "effects": "sc:Text",
    "sha256": "sc:Text",
}


def write_card(layout: Layout, recipe: Recipe, records: Sequence[dict[str, Any]]) -> None:
    """Write README.md: what the data are, how they were made, licence, versions.

    Parameters
    ----------
    layout
        Files of the data set.
    recipe
        The recipe.
    records
        Records of the pictures that pass their checks.
    """
    parts, cameras = Counter(r["part"] for r in records), Counter(r["camera"] for r in records)
    effects = Counter(e for r in records for e in r["effects"].split(", ") if e)
    grid = recipe.picture.wavelength_nm
    lines = [
        f"# {recipe.name}",
        "",
        recipe.description or "Synthetic spectral pictures of boxes with the truth about them.",
        "",
        f"- Pictures: {len(records)} of {recipe.boxes} boxes; "
        + ", ".join(f"{parts[name]} {name}" for name in ("train", "validation", "test")),
        f"- Cameras: {', '.join(f'{name} ({count})' for name, count in cameras.items()) or 'none'}",
        f"- Wavelengths: {grid.size} from {grid[0]:g} to {grid[-1]:g} nm",
        f"- Relative standard error of the median pixel: at most {recipe.picture.noise:.3g}",
        f"- Stored numbers: single precision, {recipe.picture.mantissa_bits} bits of mantissa "
        f"(relative rounding {2.0 ** -(recipe.picture.mantissa_bits + 1):.1g})",
        f"- Truths: {', '.join(recipe.picture.truths) or 'labels only'}",
        f"- Effects: {', '.join(f'{name} ({count})' for name, count in sorted(effects.items())) or 'none'}",
        f"- Licence: {recipe.license or 'not stated'}",
        f"- Made by: {', '.join(f'{name} {number}' for name, number in versions().items())}, seed {recipe.seed}",
        "",
        "The pictures are rendered, not photographed. All surfaces reflect by Lambert's law except where an effect "
        "says otherwise. Boxes of one geometry belong to one part. `recipe.toml` makes the same files again; "
        "`index.csv` lists them with their checksums. Open them with `cboxlab.open_dataset`, or with xarray.",
        "",
    ]
    with replacing(layout.folder / "README.md") as temporary:
        temporary.write_text("\n".join(lines), encoding="utf-8")


def write_croissant(layout: Layout, recipe: Recipe, records: Sequence[dict[str, Any]]) -> None:
    """Write croissant.json, the machine-readable description (Croissant 1.0).

    Parameters
    ----------
    layout
        Files of the data set, with its index.
    recipe
        The recipe.
    records
        Records of the pictures that pass their checks.
    """
    fields = [
        {
            "@type": "cr:Field",
            "@id": f"pictures/{name}",
            "name": name,
            "dataType": kind,
            "source": {"fileObject": {"@id": "index"}, "extract": {"column": name}},
        }
        for name, kind in _FIELDS.items()
    ]
    content = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": recipe.name,
        "description": recipe.description or f"{len(records)} synthetic spectral pictures of boxes with their truths.",
        "license": recipe.license or "not stated",
        "version": versions()["cboxlab"],
        "creator": {"@type": "sc:Organization", "name": "cboxlab"},  # a person or an organisation, as readers ask
        "citeAs": f"{recipe.name}, seed {recipe.seed}. Rendered by cboxlab {versions()['cboxlab']}.",
        "distribution": [
            {
                "@type": "cr:FileObject",
                "@id": "index",
                "name": INDEX,
                "contentUrl": INDEX,
                "encodingFormat": "text/csv",
                "sha256": file_hash(layout.folder / INDEX),
            },
            {
                "@type": "cr:FileSet",
                "@id": "pictures-files",
                "name": "pictures",
                "encodingFormat": MEDIA_TYPES[recipe.picture.format],
                "includes": f"boxes/*/*{PICTURE_ENDINGS[recipe.picture.format]}",
            },
        ],
        "recordSet": [{"@type": "cr:RecordSet", "@id": "pictures", "name": "pictures", "field": fields}],
    }
    write_json(layout.folder / "croissant.json", content)
