"""A workbench on a capture of 32 pixels a side, its server, and its page in a browser."""

import pytest
from cboxlab.utils.progress import NO_PROGRESS
from cboxlab.validation.app.studio import Workbench, build_app
from helpers.captures.glare_capture import glare_capture
from helpers.captures.large_patches import large_patches
from helpers.pages.browser import open_browser
from helpers.pages.server import served
from helpers.pages.studio import HERE
from starlette.testclient import TestClient


@pytest.fixture(scope="session")
def opened_bench(tmp_path_factory):
    root = tmp_path_factory.mktemp("studio")
    with large_patches():
        glare_capture(root / "capture")
        workbench = Workbench(root, root / ".cache", noise=3.0, seed=1)
        workbench.open("capture", None, NO_PROGRESS)
    return workbench


@pytest.fixture(autouse=True, scope="module")
def light_of_all_tests():
    """As when the workbench was opened."""
    with large_patches():
        yield


@pytest.fixture
def bench(opened_bench):
    """Every test begins with the study as it was opened."""
    while opened_bench.study.history.can_undo:
        opened_bench.undo()
    opened_bench.show(0, True)
    return opened_bench


@pytest.fixture
def client(bench):
    app = build_app(bench, "secret", HERE, idle_s=1e9)
    with TestClient(app, base_url="http://127.0.0.1", raise_server_exceptions=False) as test_client:
        yield test_client


@pytest.fixture(scope="module")
def browser():
    with open_browser() as page:
        yield page


@pytest.fixture
def page(browser, bench):
    browser.errors.clear()
    with served(bench) as address:
        browser.open(address)
        browser.until("document.body.dataset.open === 'true' && !document.getElementById('undo').hidden")
        browser.until("page.viewer !== null && page.controls !== null && !page.job")
        yield browser
        browser.open("about:blank?")
    # the browser asks only where a person has touched the page, and says so
    assert [error for error in browser.errors if "'beforeunload'" not in error] == []
