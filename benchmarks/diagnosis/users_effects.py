"""A user's own effects, one for every stage: hidden in captures, are they named, fitted and drawn?

    python benchmarks/diagnosis/users_effects.py                      # all of them
    python benchmarks/diagnosis/users_effects.py decentred-lens soot  # some, by name

Installs the package of tests/render/effects/own_package, hides each of its effects in a capture of 128 x 128 pixels
as blind_diagnosis.py does, and diagnoses it. Exit code 1 if one is not named first.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from blind_diagnosis import Case, run
from blind_scores import is_right
from cboxlab.rendering.effects import catalogue
from cboxlab.validation.app.commands.effect_picture import pictured_light, write_effect_picture

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

from helpers.programs.installed_effects import own_effects


def main() -> None:
    right = []
    with tempfile.TemporaryDirectory() as folder:
        builtin = set(catalogue())
        with own_effects(Path(folder)):
            names = sys.argv[1:] or sorted(set(catalogue()) - builtin)
            for seed, name in enumerate(names, 500):
                row = run(Case("single", (name,), "medium", seed))
                assert row is not None, f"{name} cannot be so strong"
                right.append(is_right(row))
                picture = Path(folder) / f"{name}.png"
                write_effect_picture(picture, catalogue()[name], pictured_light())
                print(
                    f"{name}: {'named' if right[-1] else 'NOT NAMED'}; selected {', '.join(row['selected'])}; "
                    f"truth {row['truth'][name]}, fitted {row['fitted'].get(name)}; "
                    f"chi2 {row['chi2_per_dof']:.3f} -> {row['final_chi2_per_dof']:.3f}; "
                    f"picture of {picture.stat().st_size} bytes",
                    flush=True,
                )
    print(f"{sum(right)} of {len(right)} named first")
    sys.exit(0 if all(right) else 1)


if __name__ == "__main__":
    main()
