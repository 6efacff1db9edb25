"""The same scan through rclpy and through CycloneDDS, both ways, equal to the bit."""

import importlib.util
import json
import os
import struct
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
MISSING = [name for name in ("rclpy", "cyclonedds") if importlib.util.find_spec(name) is None]
pytestmark = [
    pytest.mark.skipif(bool(MISSING), reason=f"{', '.join(MISSING)} is not installed"),
]
# Loopback only, as rclpy with its discovery range, and rclpy has no type information to compare.
CONFIGURATION = """
<CycloneDDS><Domain>
  <General>
    <Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>
    <AllowMulticast>false</AllowMulticast>
  </General>
  <Discovery>
    <ParticipantIndex>auto</ParticipantIndex>
    <MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>
    <Peers><Peer address="127.0.0.1"/></Peers>
  </Discovery>
  <Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>
</Domain></CycloneDDS>
"""


@pytest.fixture(scope="module")
def exchanged():
    domain = str(101 + os.getpid() % 100)
    environment = {
        **os.environ,
        "ROS_DOMAIN_ID": domain,
        "CYCLONEDDS_URI": CONFIGURATION,
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "PYTHONPATH": os.pathsep.join([str(HERE.parents[1] / "src")]),
    }
    sides = {
        name: subprocess.Popen(
            [sys.executable, str(HERE / "peer_program.py"), name],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for name in ("rclpy", "cyclone")
    }
    found = {}
    # Both end by themselves, after a minute without the other.
    told = {name: process.communicate(timeout=180) for name, process in sides.items()}
    for name, (out, error) in told.items():
        lines = out.splitlines()
        seen = [line for line in lines if line.startswith("SEEN ")]
        assert seen, f"{name}: {out[-1000:]} {error[-3000:]}"
        found[name] = json.loads(seen[0].removeprefix("SEEN ")), lines
    return found


def bits(*values: float) -> str:
    return struct.pack(f"{len(values)}f", *values).hex()


def test_scans_are_equal_to_the_bit_both_ways(exchanged) -> None:
    by_cyclone, _ = exchanged["cyclone"]
    assert by_cyclone["ranges"] == bits(0.1, 1.5, float("inf"), float("nan"), 3.0000002, 1e-38)
    by_rclpy, _ = exchanged["rclpy"]
    assert by_rclpy["ranges"] == bits(0.3, float("inf"), 2.5, 0.0, 29.999998)
    for seen in (by_cyclone, by_rclpy):
        assert seen["angles"] == bits(-3.0, 0.1, 30.0)
        assert seen["stamp"] == [1795465648, 123456789]
        assert seen["frame"] == "base_scan"


def test_the_other_implementation_s_message_is_converted(exchanged) -> None:
    # 0.3, 2.5 and 29.999998 m are returns; infinity and 0 are not.
    assert "POINTS 3" in exchanged["rclpy"][1]
