"""What a run shows of a battery: in metrics, figures and film."""

import dataclasses

import numpy as np
import pytest

from jaxplore.parts.battery.report import (
    BatteryRecord,
    BatteryReport,
    battery_figure,
    count_recharges,
)


def shown(charges: np.ndarray, is_docked: np.ndarray, docks: np.ndarray):
    record = BatteryRecord(charges[1:].astype(np.float32), is_docked)
    return record, BatteryReport(docks, 0.5, 0.2, float(charges[0].max()))


def test_stays_that_charge_count_and_short_ones_do_not() -> None:
    charge = np.array([1.0, 0.9, 0.5, 0.7, 0.9, 0.8, 0.82, 0.7, 0.3, 0.9])
    is_docked = np.array([True, False, True, True, False, True, False, False, True])
    # At the start it was full, then 0.4, then 0.02, and at last 0.6 up to the end.
    assert count_recharges(is_docked, charge) == 2


def test_a_run_shows_the_charge(recording) -> None:
    charges = np.linspace(1.0, 0.4, 11)
    record, report = shown(charges, np.arange(10) > 7, np.array([[1.0, 1.0]]))
    records = recording.records._replace(parts={"battery": record})
    run = dataclasses.replace(recording, records=records, parts={"battery": report})
    metrics = run.metrics()
    rows = dict(metrics.rows())
    assert rows["battery"] == "40.0 % at the end, 40.0 % at least"
    assert "recharges" not in rows
    assert metrics.as_dict()["battery"]["charging_time"] == pytest.approx(1.0)
    assert metrics.series()["charge"][-1] == pytest.approx(0.4)
    assert set(run.figures()) == {"map", "coverage", "battery"}
    figure = battery_figure(run, report)
    (line, reserve) = figure.axes[0].lines
    np.testing.assert_allclose(line.get_ydata(), 100.0 * charges, atol=1e-4)
    np.testing.assert_allclose(reserve.get_ydata(), 20.0)
    # A run in a film has its dock and its charge.
    with_dock, without = (
        np.asarray(each.frame_image(each.frames[-1]))
        for each in (run, dataclasses.replace(run, parts={}))
    )
    assert with_dock.shape != without.shape or (with_dock != without).any()
    moved = report.move(np.array([5.0, -1.0]))
    np.testing.assert_allclose(moved.docks, [[6.0, 0.0]])
