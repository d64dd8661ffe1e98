"""A page of another origin in a real browser attacks a workbench without a token: it reads and changes nothing."""

import functools
import http.server
import threading

import pytest
from helpers.pages.server import served
from test_attacks import tree

#: What the page tries on each path: every way in which a browser sends a request, and how a page may read its answer.
ATTACK = """
async function attack(base, paths) {
  const read = [], tried = [];
  const note = async (what, promise) => {
    tried.push(what);
    try { const text = await promise; if (text) read.push(what + ': ' + String(text).slice(0, 80)); } catch (error) {}
  };
  const loaded = (element, address) => new Promise((done) => {
    element.onload = () => done(element); element.onerror = () => done(null);
    element.src = address; document.body.append(element);
    setTimeout(() => done(null), 1500);
  });
  const body = JSON.stringify({which: 0, effect: 'ghost', capture: 'capture', folder: 'stolen', revision: 0});
  const names = () => Object.keys(window).filter((key) => !/^[0-9]+$/.test(key));
  const waits = [];
  for (const path of paths) {
    const url = base + path;
    for (const credentials of ['omit', 'include']) {
      waits.push(note('get ' + path, fetch(url, {credentials}).then((answer) => answer.text())));
      waits.push(note('opaque ' + path, fetch(url, {mode: 'no-cors', credentials}).then((answer) => answer.text())));
    }
    for (const type of ['text/plain', 'application/json', 'application/x-www-form-urlencoded'])
      for (const mode of ['cors', 'no-cors'])
        waits.push(note(type + ' ' + path, fetch(url, {method: 'POST', mode, body, headers: {'content-type': type}})
          .then((answer) => answer.text())));
    waits.push(note('put ' + path, fetch(url, {method: 'PUT', body}).then((answer) => answer.text())));
    tried.push('beacon ' + path);
    navigator.sendBeacon(url, new Blob([body], {type: 'text/plain'}));
    waits.push(note('frame ' + path, loaded(document.createElement('iframe'), url).then((frame) => frame &&
      frame.contentDocument && frame.contentDocument.body && frame.contentDocument.body.innerText)));
    waits.push(note('picture ' + path, loaded(document.createElement('img'), url)
      .then((image) => image && image.width)));
    const before = names().length;
    waits.push(note('script ' + path, path.startsWith('api/') ? loaded(document.createElement('script'), url)
      .then(() => names().length > before ? 'names' : '') : ''));
    const form = document.createElement('form');
    Object.assign(form, {method: 'post', action: url, enctype: 'text/plain', target: 'sink'});
    form.append(Object.assign(document.createElement('input'), {name: body.slice(0, -1) + ',"x":"', value: '"}'}));
    document.body.append(form); tried.push('form ' + path); form.submit();
  }
  waits.push(note('events', new Promise((done) => {
    const source = new EventSource(base + 'api/events');
    source.onmessage = (event) => done(event.data); source.onerror = () => done('');
  })));
  waits.push(note('socket', new Promise((done) => {
    const socket = new WebSocket(base.replace('http', 'ws') + 'api/events');
    socket.onopen = () => done('open'); socket.onerror = () => done('');
  })));
  await Promise.all(waits);
  return {read, tried: tried.length};
}
"""
PATHS = [
    *("", "studio.js", "api/state", "api/picture", "api/view", "api/effects", "api/places", "api/events"),
    *("api/cancel", "api/discard", "api/pattern", "api/earlier"),
    *(f"api/step/{name}" for name in ("add", "change", "remove", "undo", "redo", "adopt", "show")),
    *(f"api/points/{name}" for name in ("picture", "write")),
    *(f"api/first/{name}" for name in ("draft", "write", "thumbnails")),
    *(f"api/job/{name}" for name in ("open", "model", "fit", "diagnose", "save")),
]


class _Silent(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost"])
def test_a_page_of_another_origin_reads_and_changes_nothing(browser, bench, tmp_path, name):
    """On another port of this computer by its number, and by a name that leads to it."""
    (tmp_path / "evil.html").write_text('<!doctype html><title>x</title><body><iframe name="sink"></iframe>')
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(_Silent, directory=str(tmp_path)))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    before, revision = tree(bench.root), bench.revision
    try:
        with served(bench, token="") as address:
            browser.open(f"http://{name}:{server.server_address[1]}/evil.html")
            browser.run(f"(0, eval)({ATTACK!r})")
            result = browser.run(f"attack({address!r}, {PATHS!r})")
            browser.open("about:blank?")
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
    assert result["read"] == [] and result["tried"] > 350
    assert tree(bench.root) == before and bench.revision == revision and bench.study.effects == ()
