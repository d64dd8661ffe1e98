"""The workbench in the browser: a study under the hand, on this machine alone unless told otherwise.

A small Starlette application around the one viewer. Panel, Solara and NiceGUI would each bring a widget layer of their
own and two to four times as many packages (Bokeh; ipywidgets and React; Vue and Quasar), while what takes work here,
the viewer and live pictures, would have to be fitted into them. Starlette and uvicorn are two packages; the page is
plain HTML and JavaScript, which the tests drive as it is.
"""

from .app import build_app
from .serve import serve
from .workbench import Workbench

__all__ = ["Workbench", "build_app", "serve"]
