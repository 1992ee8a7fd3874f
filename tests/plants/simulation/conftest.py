import pytest

from plants.missions import cubesat3u


@pytest.fixture(scope="module")
def surroundings():
    return cubesat3u.environment(30.0)
