"""Tuning: search of parameters, and comparison with the current ones on unseen seeds.

The entry point is `tune`; `open_study` and the classes below are its parts.
"""

from jaxplore.study.tuning.controller_episodes import ControllerEpisodes as ControllerEpisodes
from jaxplore.study.tuning.episodes import Episode as Episode
from jaxplore.study.tuning.episodes import Episodes as Episodes
from jaxplore.study.tuning.episodes import Result as Result
from jaxplore.study.tuning.function_episodes import FunctionEpisodes as FunctionEpisodes
from jaxplore.study.tuning.function_episodes import VectorEpisodes as VectorEpisodes
from jaxplore.study.tuning.objective import Objective as Objective
from jaxplore.study.tuning.result import TuningResult as TuningResult
from jaxplore.study.tuning.search import Measure as Measure
from jaxplore.study.tuning.search import Search as Search
from jaxplore.study.tuning.settings_episodes import SettingsEpisodes as SettingsEpisodes
from jaxplore.study.tuning.significance import Change as Change
from jaxplore.study.tuning.space import Parameter as Parameter
from jaxplore.study.tuning.space import Space as Space
from jaxplore.study.tuning.storage import open_study as open_study
from jaxplore.study.tuning.study import SearchProgress as SearchProgress
from jaxplore.study.tuning.study import Study as Study
from jaxplore.study.tuning.trials import Trial as Trial
from jaxplore.study.tuning.tune import tune as tune
