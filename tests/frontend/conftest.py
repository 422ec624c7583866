"""One rendered drive for all tests of the front end."""

import pytest

pytest.importorskip("cv2")


@pytest.fixture(scope="session")
def drive():
    from tests.frontend.studio import rendered

    return rendered(8)


@pytest.fixture(scope="session")
def drive_folder(drive, tmp_path_factory):
    from tests.frontend.studio import write_asl

    return write_asl(tmp_path_factory.mktemp("drive"), drive)
