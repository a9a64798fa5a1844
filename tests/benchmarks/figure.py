"""The costs of all cases as ratios to CasADi's C, of cases without a peer left out."""

from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure

PANELS = (
    ("instructions, -O2", ("O2", "instructions")),
    ("instructions, -O3 FMA", ("O3", "instructions")),
    ("time, -O3 FMA", ("O3", "ns")),
    ("instructions, Cortex-M4F", ("M4F", "nominal")),
    ("text, Cortex-M4F", ("M4F", "text")),
)
COLOURS = {"hgogen": "#1f5fa8", "symforce": "#7aa874", "sympy": "#c9a227", "eigen": "#a65e5e"}


def number(costs: Mapping[str, Any], path: tuple[str, str]) -> float | None:
    """A cost, of a time its median; None where it was not measured."""
    value = costs.get(path[0], {}).get(path[1])
    return value[1] if isinstance(value, list) else value


def ratios(cases: Mapping[str, Any], path: tuple[str, str]) -> dict[str, dict[str, float]]:
    """By case and generator, over CasADi's."""
    whole: dict[str, dict[str, float]] = {}
    for name, case in cases.items():
        base = number(case["costs"].get("casadi", {}), path)
        values = {who: number(costs, path) for who, costs in case["costs"].items() if who != "casadi"}
        if base:
            whole[name] = {who: value / base for who, value in values.items() if value}
    return whole


def drawn(cases: Mapping[str, Any]) -> Figure:
    """A panel for each cost."""
    panels = [(title, whole) for title, path in PANELS if (whole := ratios(cases, path))]
    figure = Figure(figsize=(9, 1.2 + 1.9 * len(panels)), layout="constrained")
    for axes, (title, whole) in zip(figure.subplots(len(panels), squeeze=False)[:, 0], panels, strict=True):
        for j, (who, colour) in enumerate(COLOURS.items()):
            heights = [values.get(who, 0.0) for values in whole.values()]
            axes.bar([k + 0.2 * (j - 1.5) for k in range(len(whole))], heights, 0.18, color=colour, label=who)
        axes.axhline(1, color="black", linewidth=0.8)
        axes.set_xticks(range(len(whole)), list(whole))
        axes.set_ylabel("of CasADi's")
        axes.set_title(title, fontsize=10)
        axes.spines[["top", "right"]].set_visible(False)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=4, frameon=False)
    return figure
