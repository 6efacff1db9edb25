"""Tuning: searches the settings with which a robot does best.

`tune` is the way in; `open_study` and what it takes are its parts.
"""

from jaxplore.study.tuning.controllers import ControllerEpisodes as ControllerEpisodes
from jaxplore.study.tuning.episodes import Ask as Ask
from jaxplore.study.tuning.episodes import Episodes as Episodes
from jaxplore.study.tuning.episodes import Outcome as Outcome
from jaxplore.study.tuning.functions import FunctionEpisodes as FunctionEpisodes
from jaxplore.study.tuning.functions import VectorEpisodes as VectorEpisodes
from jaxplore.study.tuning.objective import Objective as Objective
from jaxplore.study.tuning.runs import SettingsEpisodes as SettingsEpisodes
from jaxplore.study.tuning.search import Measure as Measure
from jaxplore.study.tuning.search import Search as Search
from jaxplore.study.tuning.space import Parameter as Parameter
from jaxplore.study.tuning.space import Space as Space
from jaxplore.study.tuning.storage import open_study as open_study
from jaxplore.study.tuning.study import Progress as Progress
from jaxplore.study.tuning.study import Study as Study
from jaxplore.study.tuning.trials import Trial as Trial
from jaxplore.study.tuning.tune import Tuned as Tuned
from jaxplore.study.tuning.tune import tune as tune
