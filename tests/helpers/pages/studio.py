"""Steps of the workbench, by requests of a test client and in its page."""

import json
import struct
import time

import numpy as np

#: Host names of this computer.
HERE = frozenset({"127.0.0.1", "localhost"})


def record_of(answer):
    assert answer.status_code == 200, answer.text
    length = struct.unpack("<I", answer.content[:4])[0]
    return json.loads(answer.content[4 : 4 + length]), np.frombuffer(answer.content[4 + length :], "<f4")


def present(client):
    """Number of the state of the study."""
    return client.get("/secret/api/state").json()["revision"]


def step(client, name, **body):
    return record_of(client.post(f"/secret/api/step/{name}", json={"revision": present(client), **body}))


def finished(client, name, **body):
    """Run a long computation to its end; returns the state after it."""
    answer = client.post(f"/secret/api/job/{name}", json=body)
    assert answer.status_code == 202, answer.text
    while (state := client.get("/secret/api/state").json())["job"]:
        time.sleep(0.05)
    return state


def chi2(page):
    return float(page.run("document.getElementById('chi2').textContent"))


def press(page, identifier):
    page.run(f"document.getElementById('{identifier}').click()")


def add(page, effect):
    count = page.run("page.controls.length")
    page.run(f"document.getElementById('new-effect').value = '{effect}'")
    press(page, "add")
    page.until(f"page.controls.length === {count + 1}")
