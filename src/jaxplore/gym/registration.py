"""Makes the environments known to Gymnasium; imports neither it nor them before."""

ENVIRONMENT = "jaxplore/Exploration-v0"
"""By this name Gymnasium makes the environment."""


def register_environment() -> None:
    """Register `jaxplore/Exploration-v0` with Gymnasium, from then on for `gymnasium.make`.

    Where nothing can be called before, `gymnasium.make("jaxplore.gym:jaxplore/Exploration-v0")`
    does both. A second call changes nothing.

    Raises:
        ModuleNotFoundError: without Gymnasium, the extra `gym` of jaxplore.
    """
    import gymnasium

    if ENVIRONMENT not in gymnasium.registry:
        gymnasium.register(
            ENVIRONMENT,
            entry_point="jaxplore.gym.environment:ExplorationEnvironment",
            vector_entry_point=("jaxplore.gym.vector_environment:ExplorationVectorEnvironment"),
        )
