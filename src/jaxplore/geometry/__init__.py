"""Geometry: angles, paths by arc length, footprints, outlines and exact ray traversal."""

from jaxplore.geometry.angles import sin_cos as sin_cos
from jaxplore.geometry.chassis import Chassis as Chassis
from jaxplore.geometry.chassis import Stability as Stability
from jaxplore.geometry.chassis import Stance as Stance
from jaxplore.geometry.curves import arc_path as arc_path
from jaxplore.geometry.curves import clothoid_path as clothoid_path
from jaxplore.geometry.curves import line_path as line_path
from jaxplore.geometry.curves import path_through as path_through
from jaxplore.geometry.footprint import Disc as Disc
from jaxplore.geometry.footprint import Footprint as Footprint
from jaxplore.geometry.footprint import Rectangle as Rectangle
from jaxplore.geometry.outlines import Outlines as Outlines
from jaxplore.geometry.path import Path as Path
from jaxplore.geometry.path import PathErrors as PathErrors
from jaxplore.geometry.path import PathPoint as PathPoint
from jaxplore.geometry.rays import RayCells as RayCells
from jaxplore.geometry.track import race_track as race_track
