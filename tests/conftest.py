"""What tests of all packages share."""

from collections.abc import Iterator

import pytest

from syncline_schemas import native


@pytest.fixture(scope="module", params=["compiled", "numpy"])
def both_ways(request: pytest.FixtureRequest) -> Iterator[None]:
    """The tests of a module with the compiled loops, and without them."""
    if request.param == "compiled" and not native.available():
        pytest.skip("the library was not built: no compiler")
    with pytest.MonkeyPatch.context() as patch:
        if request.param == "numpy":
            patch.setattr(native, "available", lambda: False)
        yield
