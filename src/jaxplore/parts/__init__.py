"""Parts of a robot: what it knows and looks for beside its map."""

from jaxplore.parts.anomalies import Anomalies as Anomalies
from jaxplore.parts.anomalies import AnomalyTest as AnomalyTest
from jaxplore.parts.keep_out import KeepOut as KeepOut
from jaxplore.parts.keep_out_boxes import KeepOutBoxes as KeepOutBoxes
from jaxplore.parts.recognition import Look as Look
from jaxplore.parts.recognition import ObjectClasses as ObjectClasses
from jaxplore.parts.recognition import Recognition as Recognition
from jaxplore.parts.watch import IdlenessMap as IdlenessMap
