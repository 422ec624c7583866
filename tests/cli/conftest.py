"""What is in the user's cache must not decide whether a command's test passes."""

import pytest


@pytest.fixture(autouse=True)
def empty_cache(monkeypatch, tmp_path_factory):
    monkeypatch.setenv("VISLAM_CACHE", str(tmp_path_factory.mktemp("cache")))
