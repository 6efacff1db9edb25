"""What refusals of maps and worlds, and of their files, have in common."""

import pytest


def refused(action, *named) -> None:
    """Check that an action is refused in one line that names things."""
    with pytest.raises(ValueError, match=r".") as caught:
        action()
    assert type(caught.value) is ValueError
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 500
    for text in named:
        assert str(text) in message
