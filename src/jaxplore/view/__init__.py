"""Views of runs in the browser, live and afterwards; needs viser."""

from jaxplore.view.live import LiveView as LiveView
from jaxplore.view.replay import Replay as Replay
from jaxplore.view.server import is_public as is_public
