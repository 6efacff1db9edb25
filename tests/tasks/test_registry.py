"""What the registry of kinds gives out is the caller's own."""

from jaxplore.tasks.registry import KINDS, at_place, place_entries, words


def spoil(node: dict) -> None:
    """Change all that is in nested entries."""
    for value in [*node.values()]:
        if isinstance(value, dict):
            spoil(value)
    node["spoilt"] = True


def test_entries_that_a_command_changes_are_those_of_the_next_one() -> None:
    """An option of one command stayed in the entries of the word `fleet` for all that followed."""
    before = {name: at_place({}, name) for name in words()}
    before |= {name: place_entries(name) for kind in KINDS.values() for name in kind.places}
    kept = repr(before)
    for name in words():
        spoil(at_place({}, name))
    for kind in KINDS.values():
        for name in kind.places:
            spoil(place_entries(name))
            spoil(at_place({}, name))
    after = {name: at_place({}, name) for name in words()}
    after |= {name: place_entries(name) for kind in KINDS.values() for name in kind.places}
    assert repr(after) == kept
