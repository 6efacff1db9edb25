"""Options of `jaxplore tune`."""

import click

from jaxplore.cli._completion import complete_map, complete_setting, words
from jaxplore.cli._decorators import add_options
from jaxplore.cli._known import load_known

OWN = (
    "tuned",
    "also",
    "budget",
    "objectives",
    "optimizer",
    "seeds",
    "unseen",
    "population",
    "gives_up",
    "measures",
    "batch",
)
"""Names of the options of a search."""

tune_options = add_options(
    click.option(
        "--tune",
        "tuned",
        multiple=True,
        shell_complete=complete_setting,
        metavar="NAME[=LOW:HIGH[:log] | =A,B,C]",
        help="A setting, or a controller parameter by its path. Without bounds it is "
        "searched from a tenth to ten times its value.",
    ),
    click.option(
        "--also",
        multiple=True,
        metavar="FILE | NAME",
        shell_complete=complete_map,
        help="Another map, path or scenario, or a settings file with differences, such as "
        "another robot.",
    ),
    click.option(
        "--budget",
        default="100",
        show_default=True,
        metavar="N | TIME",
        help="Number of candidates, or a time such as 30min.",
    ),
    click.option(
        "--objective",
        "objectives",
        multiple=True,
        metavar="SUM",
        help="Sum of metrics to minimize, such as 'time_to.90 + 100*collisions'; several "
        "for a Pareto front.  [default: time to the end, plus a penalty per collision]",
    ),
    click.option(
        "--optimizer",
        default="tpe",
        show_default=True,
        metavar="NAME",
        shell_complete=words(load_known().optimizers),
        help=f"One of {', '.join(load_known().optimizers)}.",
    ),
    click.option("--seeds", default=5, show_default=True, help="Number of seeds per candidate."),
    click.option(
        "--unseen",
        default=10,
        show_default=True,
        help="Number of seeds, not used by the search, to compare current and chosen settings.",
    ),
    click.option(
        "--population",
        default=load_known().population,
        show_default=True,
        help="Number of candidates in a generation.",
    ),
    click.option(
        "--give-up/--no-give-up",
        "gives_up",
        default=None,
        help="Stop candidates that are worse than most after their first episodes.  "
        "[default: on with one objective, except with cma-me]",
    ),
    click.option(
        "--measure",
        "measures",
        multiple=True,
        metavar="METRIC=LOW:HIGH[:CELLS]",
        help="With --optimizer cma-me: metric over which to find diverse settings.",
    ),
    click.option(
        "--batch",
        default=1,
        show_default=True,
        help="Number of candidates in one program (vmap), for accelerators and small problems.",
    ),
)
