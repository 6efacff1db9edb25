"""Registration with Gymnasium, without importing it or the environments in advance."""

ENVIRONMENT, PATH_ENVIRONMENT = "jaxplore/Exploration-v0", "jaxplore/PathFollowing-v0"
"""Names by which Gymnasium makes the environments."""


def register_environment() -> None:
    """Register both environments with Gymnasium, for `gymnasium.make`.

    `gymnasium.make("jaxplore.gym:jaxplore/Exploration-v0")` registers and makes one in a single
    call. A second call of this function changes nothing.

    Raises:
        ModuleNotFoundError: Gymnasium is not installed, jaxplore's extra `gym`.
    """
    import gymnasium

    for name, options in ((ENVIRONMENT, {}), (PATH_ENVIRONMENT, {"path": "track"})):
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point="jaxplore.gym.environment:ScenarioEnvironment",
                vector_entry_point="jaxplore.gym.vector_environment:ScenarioVectorEnvironment",
                kwargs=options,
            )
