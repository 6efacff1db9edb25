from typing import Any

from jaxplore.study.comparison.table import NEEDED, list_failures, map_tables


def row(map_: str, explorer: str, seed: int, time: float | None, **more: Any) -> dict[str, Any]:
    values: dict[str, Any] = dict.fromkeys(NEEDED)
    values |= {"map": map_, "explorer": explorer, "seed": seed, "is_finished": time is not None}
    values |= {f"{kind}_to_{level}": time for kind in ("time", "path") for level in (90, 99)}
    return {**values, "coverage": 0.5, "collisions_per_100m": 0.0, **more}


ROWS = [
    *(row("hall", "explorer", seed, 10.0 + seed) for seed in range(3)),
    *(row("hall", "nearest-frontier", seed, 20.0 + 2 * seed) for seed in range(3)),
    row("house", "explorer", 0, None, collisions_per_100m=1.234),
    row("house", "explorer", 1, None, error="no room"),
    row("house", "explorer", 2, None, error="no room"),
    row("shed", "explorer", 0, None, error="no image"),
]


def test_there_is_a_table_for_each_map_with_a_row_for_each_explorer() -> None:
    hall, house = map_tables(ROWS)
    assert [hall.map, house.map] == ["hall", "house"]
    assert [len(each) for each in (*hall.rows, *house.rows)] == [8] * 5
    header, *rows = hall.rows
    assert header[:4] == ("", "finished", "90 % after [s]", "90 % path [m]")
    assert rows[0][:3] == ("explorer", "3 of 3", "11.0\n[10.5, 11.5]\nx 0.50 [0.50, 0.50]")
    # What is compared with itself says nothing.
    assert rows[1][:3] == ("nearest-frontier", "3 of 3", "22.0\n[21.0, 23.0]")
    # Coverage and collisions are no times: no ratios.
    assert rows[0][6:] == ("50.0", "0.00")
    assert house.rows[1] == ("explorer", "0 of 1", *["-"] * 4, "50.0", "1.23")


def test_a_ratio_needs_the_same_seeds() -> None:
    alone = [each for each in ROWS if each["map"] == "hall"]
    alone = [each | {"seed": each["seed"] + 9 * (each["explorer"] == "explorer")} for each in alone]
    (hall,) = map_tables(alone)
    assert hall.rows[1][2] == "11.0\n[10.5, 11.5]"


def test_there_is_no_ratio_to_what_never_got_there() -> None:
    late = [row("hall", "nearest-frontier", seed, None if seed else 5.0) for seed in range(3)]
    (hall,) = map_tables([*ROWS[:3], *late])
    assert hall.rows[1][2] == "11.0\n[10.5, 11.5]"
    assert hall.rows[2][2] == "-"
    some = [row("hall", "nearest-frontier", seed, 22.0 if seed else None) for seed in range(3)]
    (hall,) = map_tables([*ROWS[:3], *some])
    assert hall.rows[1][2].startswith("11.0\n[10.5, 11.5]\nx 0.50 [0.00, ")


def test_list_failures_are_counted() -> None:
    assert list_failures(ROWS) == [
        "house, explorer: 2 runs failed: no room",
        "shed, explorer: 1 run failed: no image",
    ]
    assert map_tables([]) == []
