"""What packages show: one name for one thing."""

from collections import defaultdict
from importlib import import_module

from architecture import FOLDERS, INSTALLED


def faces():
    """Pairs of a package and a name that its ``__all__`` lists, with the object."""
    for room, folder in FOLDERS.items():
        for path in sorted(folder.rglob("__init__.py")):
            parts = path.parent.relative_to(folder).parts
            package = import_module(".".join(["cboxlab", INSTALLED.get(room, room), *parts]))
            for name in getattr(package, "__all__", ()):
                yield package.__name__, name, getattr(package, name)
    public = import_module("cboxlab")
    yield from (("cboxlab", name, getattr(public, name)) for name in public.__all__)


def test_a_name_means_the_same_in_all_packages():
    """A stranger who reads ``Verdict`` in two rooms may take it for one class."""
    meanings = defaultdict(dict)
    for package, name, value in faces():
        if not name.startswith("__"):
            meanings[name].setdefault(id(value), package)
    assert {name: [*packages.values()] for name, packages in meanings.items() if len(packages) > 1} == {}
    assert len(meanings) > 500
