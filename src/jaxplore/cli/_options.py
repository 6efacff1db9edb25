"""Options that the commands share."""

from typing import Any

import click

from jaxplore.cli._completion import complete_assignment, complete_map, values_of
from jaxplore.cli._decorators import OVERWRITE, TRUST, Decorator, add_options, path_option
from jaxplore.cli._known import load_known

_OPTIONS: tuple[tuple[str, str, Any, str], ...] = (
    ("--seed", "seed", int, "Seed of all random numbers."),
    ("--time-limit", "time_limit", float, "Simulated time [s]."),
    ("--target-coverage", "target_coverage", float, "Share of reachable cells at which to stop."),
    ("--resolution", "resolution", float, "Side of a map cell [m]; finer maps are resampled."),
    (
        "--robot",
        "robot.model",
        str,
        "Model of the robot: differential_drive, omnidirectional, unicycle, ackermann, bicycle, "
        "quadrotor, or MODULE:NAME of your own.",
    ),
    (
        "--architecture",
        "architecture",
        str,
        f"explorer, portfolio, or a baseline: {', '.join(load_known().baselines)}; two-layer, "
        "parallel, sequential, random-walk, goal, by default for quadrotors. Or "
        "MODULE:NAME of your own.",
    ),
    ("--radius", "robot.radius", float, "Radius of the robot [m]."),
    ("--max-speed", "robot.max_speed", float, "Speed of the robot [m/s]."),
    ("--beams", "lidar.num_beams", int, "Number of lidar beams."),
    ("--range", "lidar.max_range", float, "Range of the lidar [m]."),
    ("--people", "people.number", int, "Number of people who walk on the map."),
    ("--people-speed", "people.speed", float, "Speed of these people [m/s]."),
    ("--robots", "fleet.robots", int, "Number of robots of a fleet."),
    ("--radio-range", "fleet.radio_range", float, "Range of the radio of a fleet's robots [m]."),
    (
        "--coordination",
        "fleet.coordination",
        str,
        "How the robots of a fleet divide the places: claims, assignment or none.",
    ),
    ("--samples", "controller.num_samples", int, "Number of MPPI rollouts."),
)
"""Options of single settings: option, dotted setting, type, help."""


class PlaceOption(click.Option):
    """An option that takes `nargs` numbers, or one more, the height in a volume."""

    def add_to_parser(self, parser: Any, ctx: click.Context) -> None:
        """Let the option take one more argument, if it is a number."""
        super().add_to_parser(parser, ctx)
        for name in self.opts:
            option = parser._long_opt[name]  # click has no public way to it

            def process(value: Any, state: Any, former: Any = option.process) -> None:
                if state.rargs and _is_number(state.rargs[0]):
                    value = (*value, state.rargs.pop(0))
                former(value, state)

            option.process = process

    def type_cast_value(self, ctx: click.Context, value: Any) -> Any:
        """Convert one text more as the others are."""
        if isinstance(value, tuple) and len(value) == self.nargs + 1:
            return tuple(self.type(each, self, ctx) for each in value)
        return super().type_cast_value(ctx, value)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def with_options(*without: str) -> Decorator:
    """Return a decorator that adds the options of a run: the map, the start, and the settings."""
    added = [
        click.argument(
            "map_", metavar="[MAP.yaml | NAME]", required=False, shell_complete=complete_map
        ),
        click.option(
            "--start",
            cls=PlaceOption,
            nargs=3,
            type=float,
            metavar="X Y [Z] YAW",
            help="Start pose [m, m, rad], with the height Z [m] in a volume.  [default: that of "
            "the map or scenario, else the position with the greatest clearance]",
        ),
        click.option(
            "--goal",
            cls=PlaceOption,
            nargs=2,
            type=float,
            metavar="X Y [Z]",
            help="Goal position [m], with the height Z in a volume, reached within the setting "
            "goal_radius; zones define their own.",
        ),
    ]
    for flag, setting, kind, text in _OPTIONS:
        if setting in without:
            continue
        ground, flying = load_known().settings[setting]
        value = f"{ground}" if ground == flying else f"{ground}; {flying} for quadrotors"
        name, text = setting.replace(".", "__"), f"{text}  [default: {value}]"
        complete = values_of(setting) if kind is str else None
        added.append(click.option(flag, name, type=kind, help=text, shell_complete=complete))
    added += [
        path_option(
            "--settings",
            "settings_file",
            metavar="FILE",
            text="Settings file in YAML, for example settings.yaml of a run; options override it.",
        ),
        click.option(
            "--set",
            "assignments",
            multiple=True,
            metavar="NAME=VALUE",
            shell_complete=complete_assignment,
            help="Any other setting, for example --set fields.decay_length=3 (see 'jaxplore "
            "settings').",
        ),
        TRUST,
        OVERWRITE,
    ]
    return add_options(*added)


path_options = add_options(
    click.option(
        "--path",
        "path_file",
        metavar="FILE",
        help="Path to follow, in CSV or YAML.  [default: a generated track]",
    ),
    click.option("--laps", type=int, help="Laps of a closed path.  [default: 1]"),
    click.option(
        "--obstacles",
        "obstacles__number",
        type=int,
        help="Moving obstacles on a path.  [default: 0]",
    ),
)
