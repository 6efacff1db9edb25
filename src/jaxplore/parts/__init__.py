"""Parts of a robot: what it knows and looks for beside its map, and what is true of it.

Each part is a folder: `robot` is what runs on board, `truth` what a simulation knows, `report`
what a run shows, and `settings` what settings files say; `registry` has a row for each.
"""

from jaxplore.parts.anomalies.robot import Anomalies as Anomalies
from jaxplore.parts.anomalies.robot import AnomalyTest as AnomalyTest
from jaxplore.parts.anomalies.truth import PlantedAnomalies as PlantedAnomalies
from jaxplore.parts.battery.robot import Battery as Battery
from jaxplore.parts.battery.truth import TrueBattery as TrueBattery
from jaxplore.parts.faults.truth import Faults as Faults
from jaxplore.parts.keep_out.boxes import KeepOutBoxes as KeepOutBoxes
from jaxplore.parts.keep_out.robot import KeepOut as KeepOut
from jaxplore.parts.moving.truth import MovingObstacles as MovingObstacles
from jaxplore.parts.recognition.robot import Look as Look
from jaxplore.parts.recognition.robot import ObjectClasses as ObjectClasses
from jaxplore.parts.recognition.robot import Recognition as Recognition
from jaxplore.parts.recognition.truth import Objects as Objects
from jaxplore.parts.variation.truth import Variation as Variation
from jaxplore.parts.watch.robot import IdlenessMap as IdlenessMap
from jaxplore.parts.watch.truth import WatchTruth as _WatchTruth  # noqa: F401, a default
from jaxplore.parts.wheels.truth import Wheels as Wheels
