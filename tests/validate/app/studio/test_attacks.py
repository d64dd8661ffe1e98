"""Attacks on the workbench: more than 2,000 requests read, write and replace nothing outside its folder."""

import gzip
import hashlib
import json
import os
import time
from itertools import product
from types import SimpleNamespace

import pytest
from cboxlab.utils.errors import InputError
from cboxlab.utils.input_files import inputs_below, read_text
from cboxlab.validation.app.studio import ANY_ADDRESS, Workbench, build_app
from cboxlab.validation.app.studio.autosave import autosave
from helpers.captures.glare_capture import glare_capture
from starlette.testclient import TestClient

#: Text of the files outside the workbench's folder, which no answer may contain.
SECRET = "do-not-repeat-7d1f"
HOSTS = frozenset({"127.0.0.1", "localhost", "[::1]"})
JSON = {"content-type": "application/json"}
JSON_VALUES = [None, True, -1, 2**70, 1.5, "", "x" * 300, "x" * 5000, [], [1, "a"], {}, {"a": {"b": 1}}, "\0", "inf"]


#: Paths of the page that read, and that change something.
READ = ["state", "picture", "view", "effects", "places"]
CHANGE = ["cancel", "discard", "pattern", "earlier", "step/undo", "first/draft", "points/write", "job/open", "job/save"]


def tree(*folders):
    """Content of every file below the folders, as digests."""
    files = [path for folder in folders for path in sorted(folder.rglob("*")) if path.is_file()]
    return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """The workbench's folder with a capture, and a folder of secrets next to it."""
    base = tmp_path_factory.mktemp("attacks")
    root, outside = base / "root", base / "outside"
    outside.mkdir()
    glare_capture(root / "capture")
    for name in ("secret.toml", "secret", "secret.csv", "secret.obj", "secret.png", "study.json", "capture.toml"):
        (outside / name).write_text(f"{SECRET} = {SECRET}\n{SECRET}\n")
    (outside / "effect.toml").write_text(f'format = "effect/1"\ntitle = "{SECRET}"\n[field]\n')
    (outside / "model.toml").write_text(f'format = "model/1"\nname = "{SECRET}"\nscene = "{SECRET}"\n')
    (root / "link.toml").symlink_to(outside / "secret.toml")
    (root / "linked").symlink_to(outside)
    os.mkfifo(root / "pipe.toml")
    (outside / "unsaved").mkdir()
    (outside / "unsaved" / "study.json").write_text("{}")
    (root / ".cbox-unsaved").symlink_to(outside)
    (root / "mine").mkdir()
    (root / "mine" / "model.toml").write_text('format = "model/1"\nscene = "cornell-box"\n')
    return root, outside


@pytest.fixture(scope="module")
def client(folders):
    app = build_app(Workbench(folders[0], None, noise=3.0, seed=1), "secret", HOSTS, idle_s=1e9)
    with TestClient(app, base_url="http://127.0.0.1", raise_server_exceptions=False) as test_client:
        yield test_client


@pytest.fixture(autouse=True)
def unchanged(folders):
    """Nothing is written outside the folder, and nothing in it is replaced."""
    before = tree(*folders)
    yield
    after = tree(*folders)
    assert {path: after.get(path) for path in before} == before
    assert not {path for path in after if str(folders[1]) in path} - set(before)


def answered(client, path, body):
    """Body of the answer to a request, or the error of the computation that it started."""
    answer = client.post(f"/secret/api/{path}", content=json.dumps(body), headers=JSON)
    assert answer.status_code in (200, 202, 400), answer.text
    if answer.status_code == 202:
        while (state := client.get("/secret/api/state").json())["job"]:
            time.sleep(0.002)
        text = state["error"]
    else:
        text = answer.json().get("error", "") if answer.status_code == 400 else answer.content.decode("latin-1")
    assert SECRET not in text and "Traceback" not in text and "error of the program" not in text, text
    return text


def names(outside):
    """Names that lead out of the folder, or nowhere."""
    files = ["secret.toml", "effect.toml", "model.toml", "secret"]
    paths = [str(outside / name) for name in files] + [f"../outside/{name}" for name in files]
    paths += [f"capture/../../outside/{name}" for name in files] + [f"linked/{name}" for name in files]
    paths += [str(outside), "../outside", "linked", "..", "../..", "/", "/etc/passwd", "/etc/passwd.toml", "/dev/zero"]
    paths += ["/proc/self/environ", "link.toml", "pipe.toml", "~/x.toml", "$HOME/x.toml", "file:///etc/passwd"]
    paths += ["..\\outside\\secret.toml", "..%2foutside%2fsecret.toml", "%2e%2e/outside/secret.toml", "\0.toml"]
    paths += ["a" * 300, "a" * 300 + ".toml", "a/" * 2000 + "b.toml", "．．/outside/secret.toml", "capture\0/x"]
    paths += ["\ud800", "a\ud800.toml", "*.toml", ".cbox-unsaved/unsaved", ".cbox-unsaved", ".cbox-unsaved/../mine/x"]
    return [*paths, f"//{outside}/secret.toml", f"./{'../' * 20}etc/passwd.toml", f"{outside}/../outside/secret.toml"]


def test_names_that_leave_the_folder_are_refused(client, folders):
    count = 0
    for name in names(folders[1]):
        for path, body in [
            ("job/open", {"capture": name}),
            ("job/open", {"capture": "capture", "model": name}),
            ("job/model", {"model": name}),
            ("step/add", {"effect": name}),
            ("job/save", {"folder": name}),
            ("points/picture", {"capture": name}),
            ("first/draft", {"folder": name}),
            ("first/write", {"folder": name}),
            ("points/write", {"capture": name, "points": [{"id": "c02", "u": 1, "v": 1}]}),
            ("first/thumbnails", {"folder": name}),
            ("discard", {"study": name}),
        ]:
            assert answered(client, path, body), (path, name)
            count += 1
    assert count > 400
    assert (folders[1] / "unsaved" / "study.json").exists()


def test_numbers_of_any_size_are_refused_in_a_line(client):
    """Integers that are larger than any float, and numbers that JSON reads as infinity."""
    answered(client, "points/picture", {"capture": "capture"})
    for number in ("1" + "0" * 400, "-1" + "0" * 400, "1e999", "-1e999", "true", '"1"', "null", "[1]", '"\\ud800"'):
        for path, body in [
            ("points/locate", f'{{"capture": "capture", "points": [{{"id": "c02", "u": {number}, "v": 5}}]}}'),
            ("points/write", f'{{"capture": "capture", "points": [{{"id": "c02", "u": 5, "v": {number}}}]}}'),
            ("step/add", f'{{"effect": "veiling-glare", "values": {{"fraction": {number}}}}}'),
            ("step/change", f'{{"which": {number}}}'),
        ]:
            answer = client.post(f"/secret/api/{path}", content=body, headers=JSON)
            assert answer.status_code in (400, 409) and "\n" not in answer.text, (path, number, answer.text)


def test_the_list_of_inputs_leaves_out_what_leads_outside(client, folders):
    """A pipe would never end, a link leads outside; unsaved work is not looked for behind a link."""
    lists = client.get("/secret/api/places").json()
    assert "mine/model.toml" in lists["models"] and "capture" in lists["captures"]
    assert not {"pipe.toml", "link.toml"} & set(lists["models"]) and lists["unsaved"] == []


def test_a_studys_folder_with_links_to_folders_is_not_written(client, folders):
    """A study of somebody else's, whose folder of the diagnosis or of pictures leads outside."""
    for name in ("diagnosis", "maps"):
        folder = folders[0] / f"their-{name}"
        folder.mkdir()
        (folder / "study.json").write_text("{}")
        (folder / name).symlink_to(folders[1])
        assert "a link to a folder" in answered(client, "job/save", {"folder": folder.name, "report": True})
        assert not (folder / "model.toml").exists()


def test_unsaved_work_is_not_stored_behind_a_link(folders, caplog):
    study = SimpleNamespace(captures=[SimpleNamespace(folder=folders[0] / "capture")])
    assert autosave(folders[0], study, None) is None
    assert "unsaved work is not stored" in caplog.text


def test_files_below_the_folder_open_no_others(client, folders):
    """Scenes, tables, meshes, effects and captures that a model, a scene or a study names."""
    root, outside = folders
    scene = 'format = "scene/1"\nname = "x"\n[lamp]\nname = "l"\nradiance = "{table}"\n{more}'
    targets = [str(outside), "../outside", "linked"]
    folder = root / "hostile"
    folder.mkdir()
    for target in targets:
        texts = [
            f'format = "model/1"\nscene = "{target}/secret.toml"\n',
            f'format = "model/1"\n[[effect]]\nid = "{target}/effect.toml"\n',
            scene.format(table=f"{target}/secret.csv:a", more=""),
            scene.format(table="A", more=f'[[surface]]\nname = "s"\nmaterial = "m"\nmesh = "{target}/secret.obj"\n'),
        ]
        for text in texts:
            (root / "hostile.toml").write_text(text)
            assert answered(client, "job/open", {"capture": "capture", "model": "hostile.toml"})
        study = {"format": "study/1", "name": "x", "scene": "cornell-box", "at": 0}
        study |= {"render": {"noise": 1.0, "max_bounces": None, "seed": 0}}
        state = {"effects": [{"id": f"{target}/effect.toml"}], "rendered_with": []}
        for changed in (
            {"captures": [target], "states": [{"effects": [], "rendered_with": []}]},
            {"captures": ["../capture"], "states": [state]},
            {"captures": ["../capture"], "scene": f"{target}/secret.toml", "states": [state]},
        ):
            (folder / "study.json").write_text(json.dumps(study | changed))
            assert answered(client, "job/open", {"capture": "hostile"})


def test_other_types_of_json_are_refused_in_a_line(client):
    keys = {
        "job/open": ["capture", "model"],
        "job/model": ["model"],
        "job/fit": ["which"],
        "job/save": ["folder", "report"],
        "step/add": ["effect", "values"],
        "step/change": ["which", "values", "commit"],
        "step/remove": ["which"],
        "step/show": ["capture", "refit"],
        "first/write": ["folder", "entries"],
        "points/locate": ["capture", "points"],
        "points/write": ["capture", "points"],
    }
    requests = [(path, key, value) for path, names in keys.items() for key in names for value in JSON_VALUES]
    for path, key, value in requests:
        text = answered(client, path, {key: value})
        assert text and "\n" not in text and len(text) < 600, (path, key, value, text)
    for content in (b"NaN", b'{"which": NaN}', b'{"which": -Infinity}', b"[" * 60000, b'"' + b"x" * 60000, b"\xff\xfe"):
        answer = client.post("/secret/api/step/undo", content=content, headers=JSON)
        assert answer.status_code == 400, answer.text
    assert len(requests) > 180


def test_other_methods_do_nothing(client):
    """Methods that a path does not have, also in other letters and of other protocols; HEAD sends no body."""
    methods = ["PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "CONNECT", "PROPFIND", "MOVE", "COPY", "MKCOL", "X"]
    pairs = [*product([*methods, "POST"], READ), *product([*methods, "GET", "HEAD"], CHANGE)]
    for method, path in pairs:
        answer = client.request(method, f"/secret/api/{path}", content=b"{}", headers=JSON)
        assert answer.status_code == 405 and SECRET not in answer.text, (method, path, answer.status_code)
    assert len(pairs) > 170


def test_paths_that_climb_out_of_the_page_are_no_paths(client, folders):
    """Spellings of '..', of depths and below every kind of path: no file is served."""
    climbs = ["..", "%2e%2e", ".%2e", "%252e%252e", "..%2f", "..%5c", "%c0%ae%c0%ae", "%u002e%u002e", "....//", "%00"]
    targets = ["outside/secret.toml", "etc/passwd", "proc/self/environ", "studio.py", str(folders[1] / "secret.toml")]
    bases = ["/secret/", "/secret/api/", "/secret/api/job/", "/secret/studio.js/", "/"]
    addresses = [f"{base}{(climb + '/') * n}{t}" for base, climb, n, t in product(bases, climbs, (1, 9), targets)]
    for address in addresses:
        answer = client.get(address)
        assert answer.status_code in (403, 404, 405) and SECRET not in answer.text, (address, answer.status_code)
        assert "root:" not in answer.text and "PATH=" not in answer.text, address
    assert len(addresses) == 500


def test_a_wrong_token_is_no_address_of_the_page(client):
    tokens = ["", "Secret", "SECRET", "secre", "secrets", "secret%00", "secret%20", "%73ecret/", "*", "..", "s" * 5000]
    for token, path in product(tokens, (*READ, *CHANGE)):
        answers = client.get(f"/{token}/api/{path}"), client.post(f"/{token}/api/{path}", json={})
        assert {answer.status_code for answer in answers} <= {404, 405}, (token, path)


#: Types of content that are not JSON's.
OTHER_TYPES = """
text/plain | text/json | application/jsonx | application/x-www-form-urlencoded | APPLICATION/XML | image/png | */*
| multipart/form-data; boundary=x | application/json, text/plain | application/json x |
"""
#: Bodies that are no JSON object.
NO_OBJECTS = [b"x", b"[]", b"null", b'"x"', b"1", b'{"capture": "capture"', b"{'a': 1}", b'{"a": 01}', b"{,}", b"{}{}"]
NO_OBJECTS += [b'{"x": "' + b"x" * 2**20 + b'"}', b'{"x":' * 9000, b"\0" * 70000, gzip.compress(b"{}"), b"\xef\xbb{}"]


def test_bodies_of_other_types_encodings_and_sizes_are_refused_in_a_line(client):
    requests = [(kind.strip(), b"{}") for kind in OTHER_TYPES.split("|")]
    requests += [("application/json", body) for body in NO_OBJECTS]
    for (kind, body), path in product(requests, CHANGE[1:]):
        answer = client.post(f"/secret/api/{path}", content=body, headers={"content-type": kind})
        assert answer.status_code == 400, (kind, body[:30], path, answer.status_code)
        assert "\n" not in answer.text and len(answer.text) < 600, answer.text
    assert len(requests) * len(CHANGE[1:]) > 190


def test_a_folder_that_is_no_studys_is_not_written(client):
    for name in ("capture", "capture/frames", "capture/new", "mine", "."):
        assert answered(client, "job/save", {"folder": name})


@pytest.mark.parametrize("token", ["secret", ""])
def test_foreign_names_and_pages_are_refused_with_and_without_a_token(folders, token):
    app = build_app(Workbench(folders[0]), token, HOSTS)
    prefix = f"/{token}" if token else ""
    foreign = ["evil.example", "evil.example:80", "127.0.0.1.evil.example", "localhost.evil.example", "[::2]", "", "0"]
    foreign += ["127.1", "2130706433", "0x7f.0.0.1", "127.0.0.2", "localhost.", "evil@127.0.0.1.example", "::1"]
    foreign += ["[::1].evil.example", "[::ffff:127.0.0.1]", "0.0.0.0", "evil.example/127.0.0.1", "127.0.0.1, evil"]
    with TestClient(app, base_url="http://127.0.0.1", raise_server_exceptions=False) as test_client:
        for host, path in product(foreign, ["/", "/api/state", "/api/places", "/api/effects", "/studio.js"]):
            headers = {"host": host, "origin": f"http://{host}"}
            assert test_client.get(prefix + path, headers=headers).status_code == 403, host
        for origin in ["http://evil.example", "null", "http://127.0.0.1.evil.example", "http://127.0.0.1:1", "file://"]:
            for path in ("step/undo", "job/open", "cancel"):
                answer = test_client.post(f"{prefix}/api/{path}", json={}, headers={"origin": origin})
                assert answer.status_code == 403, origin
        assert test_client.get(f"{prefix}/", headers={"origin": "http://127.0.0.1"}).status_code == 200


def test_every_address_of_the_computer_is_allowed_but_no_foreign_name(folders):
    app = build_app(Workbench(folders[0]), "", HOSTS | {ANY_ADDRESS, "laboratory"})
    with TestClient(app, base_url="http://127.0.0.1") as test_client:
        for host in ("192.168.0.7:8000", "[fe80::1]:8000", "laboratory", "localhost:1"):
            assert test_client.get("/", headers={"host": host}).status_code == 200
        for host in ("evil.example", "192.168.0.7.evil.example", "*", "laboratory.evil.example"):
            assert test_client.get("/", headers={"host": host}).status_code == 403


def test_a_file_of_another_folder_is_refused_before_it_is_looked_at(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.txt").write_text("a")
    (tmp_path / "b.txt").write_text("b")
    with inputs_below(tmp_path / "in"):
        assert read_text(tmp_path / "in" / "a.txt", "a text") == "a"
        errors = []
        for name in ("b.txt", "missing.txt", "in/../b.txt"):
            with pytest.raises(InputError, match="outside") as error:
                read_text(tmp_path / name, "a text")
            errors.append(str(error.value).partition(":")[2])
        assert len(set(errors)) == 1  # whether the file exists is not said
    assert read_text(tmp_path / "b.txt", "a text") == "b"
