"""A validation in the terminal: table by surface, headline figures, verdict."""

from __future__ import annotations

from .console import console, data_table, say
from .pipeline import Validation, failures
from .verdict import verdict

__all__ = ["print_failures", "print_validation"]


def print_validation(result: Validation) -> None:
    """Print the table by surface, the headline figures and the verdict."""
    c = result.comparison
    table = data_table(
        f"{result.prepared.calibration.capture.folder.name}: (measured − rendered) / rendered, interiors, %",
        "surface", *c.bands, "ΔE*ab", "χ²/dof",
    )  # fmt: skip
    for name, row in c.by_surface.items():
        table.add_row(
            name,
            *(f"{100 * v:+.2f}" for v in row.relative),
            f"{row.delta_e_ab:.2f}",
            f"{row.chi2.per_dof:.2f}",
        )
    console.print(table)
    say(
        f"χ² per degree of freedom {c.chi2.per_dof:.3f} (interiors {c.chi2_interiors.per_dof:.3f}, edges "
        f"{c.chi2_edges.per_dof:.3f}); mean ΔE*ab {c.delta_e_ab.mean:.2f} (noise alone "
        f"{c.delta_e_ab_noise.mean:.2f}); render/sensor noise {c.render_sigma_over_sensor_sigma:.2f}; "
        f"lamp × {result.fit.lamp_scale:.4f}; {result.seconds:.0f} s"
    )
    console.print(f"[bold]{verdict(c).headline}[/]")
    print_failures(result)


def print_failures(result: Validation) -> None:
    """Print where the model fails, most of the excess in the least room first."""
    for rank, failure in enumerate(failures(result)[1], 1):
        say(f"{rank}. {failure.sentence}")
