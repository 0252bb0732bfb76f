"""`isas effects`: which light transport a run would simulate, and the evidence."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

from ..config.compose import compose, translate
from ..engine import experiment
from ..engine.display import Display
from ..runtime import interrupt
from . import one

if TYPE_CHECKING:
    from ..effects.plan import Plan
    from ..effects.probe import Cut


def main(arguments: list[str]) -> int:
    """Print the plan of the run that ``arguments`` describe. Raises IsasError; returns 0."""
    one.no_flags("effects", arguments)
    one.no_sweep(arguments, "leave it out")
    with one.argv(["isas", "effects", *arguments]), interrupt.prompt():
        cfg = compose(translate(arguments))
        typed, budget = experiment.checked(cfg)
        _, (choices,) = experiment.started([cfg], typed)
        with Display(budget) as display:
            phases = experiment.Phases(display)
            problem = experiment.built(typed, phases, [choices])
            phases.begin("probe")
            from ..engine.workshop import plan_of

            plan = plan_of(problem, choices, budget)
            phases.begin(None)
        show(plan, Console())
    return 0


def show(plan: "Plan", console: Console) -> None:
    """The plan and what it rests on, as tables."""
    table = Table("effect", "what is done about it, and why", title="effects of a run")
    for effect, told in plan.statements.items():
        table.add_row(effect, Text(told))
    console.print(table)
    longer = "what the derivatives of longer paths are", "what longer paths are"
    for title, cuts in zip(longer, (plan.derivatives, plan.cuts)):
        if cuts:
            console.print(_cuts(title, {f"up to {cut.depth} edges": cut for cut in cuts}))
    if plan.caustics:
        console.print(_cuts("what caustics are", {"none": plan.caustics}))
    if plan.samples:
        table = Table(
            "light samples: residual, derivative", title="the first = 1; ± one standard error"
        )
        for column in ("noise", "time of a step", "noise × time"):
            table.add_column(column, justify="right")
        for each in plan.samples:
            samples = ", ".join(map(str, each.samples))
            if each.directions > 1:
                samples += f", picked from {each.directions} directions"
            noise = f"{each.noise:.2f} ± {each.error:.2f}"
            table.add_row(samples, noise, f"{each.time:.2f}", f"{each.noise * each.time:.2f}")
        console.print(table)
    if plan.seconds:
        console.print(f"a run is billed {plan.seconds:.1f} s for these measurements")


def _cuts(title: str, cuts: dict[str, "Cut"]) -> Table:
    """``cuts``: by what is left."""
    table = Table("what is left", title=f"{title}; in brackets bounds, each with 95 %")
    for column in ("of the images", "of the gradient", "time without them"):
        table.add_column(column, justify="right")
    for left, each in cuts.items():
        key, worst = max(each.gradient.items(), key=lambda pair: pair[1].bound)
        of_gradient = f"{_share(worst)} {key}" if len(each.gradient) > 1 else _share(worst)
        of_image = _share(each.image) if each.image else "–"
        table.add_row(left, of_image, Text(of_gradient), f"{each.time:.2f}")
    return table


def _share(share) -> str:
    return f"{share.value:.2%} ({share.low:.2%} to {share.bound:.2%})"
