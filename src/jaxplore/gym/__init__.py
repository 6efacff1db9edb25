"""Registration of jaxplore's environment with Gymnasium; importing this package registers it:

    gymnasium.make("jaxplore.gym:jaxplore/Exploration-v0")

Importing jaxplore itself registers nothing.
"""

from jaxplore.gym.registration import register_environment as register_environment

register_environment()
