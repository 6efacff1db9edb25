"""Tuning: searches the settings with which a robot does best.

`tune` is the way in; `open_study` and what it takes are its parts.
"""

from jaxplore.tuning.controllers import ControllerEpisodes as ControllerEpisodes
from jaxplore.tuning.episodes import Ask as Ask
from jaxplore.tuning.episodes import Episodes as Episodes
from jaxplore.tuning.episodes import Outcome as Outcome
from jaxplore.tuning.functions import FunctionEpisodes as FunctionEpisodes
from jaxplore.tuning.functions import VectorEpisodes as VectorEpisodes
from jaxplore.tuning.objective import Objective as Objective
from jaxplore.tuning.runs import SettingsEpisodes as SettingsEpisodes
from jaxplore.tuning.search import Measure as Measure
from jaxplore.tuning.search import Search as Search
from jaxplore.tuning.space import Parameter as Parameter
from jaxplore.tuning.space import Space as Space
from jaxplore.tuning.storage import open_study as open_study
from jaxplore.tuning.study import Progress as Progress
from jaxplore.tuning.study import Study as Study
from jaxplore.tuning.trials import Trial as Trial
from jaxplore.tuning.tune import Tuned as Tuned
from jaxplore.tuning.tune import tune as tune
