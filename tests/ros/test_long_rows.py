"""Rows of a bag that are longer than any message."""

import sqlite3
from pathlib import Path
from types import SimpleNamespace as Fields

import pytest

from jaxplore.ros.bag import MESSAGE_LIMIT, bag_topics, read_bag
from jaxplore.ros.bag_writer import BagWriter

pytest.importorskip("rosbags")


@pytest.mark.parametrize("column", ["data", "name"])
def test_a_long_row_is_refused_by_the_database_and_not_read(tmp_path: Path, column: str) -> None:
    vector = Fields(x=0.0, y=0.0, z=0.0)
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/command", "Twist", Fields(linear=vector, angular=vector), 1.0)
    (file,) = (tmp_path / "bag").glob("*.db3")
    assert [each.topic for each in read_bag(file, ["/command"])] == ["/command"]
    table = "messages" if column == "data" else "topics"
    with sqlite3.connect(file) as database:
        database.execute(f"UPDATE {table} SET {column} = zeroblob({2 * MESSAGE_LIMIT})")
    database.close()
    with pytest.raises(ValueError, match="too big"):
        list(read_bag(file, list(bag_topics(file))))
