"""Workbench in the browser for a study, on this computer only by default.

It is a Starlette application around the viewer of the reports. Panel, Solara and NiceGUI would each add a widget layer
and two to four times as many packages (Bokeh; ipywidgets and React; Vue and Quasar). The viewer and the live pictures
would still have to be fitted into them. Starlette and uvicorn are two packages. The page is plain HTML and JavaScript,
which the tests drive directly.
"""

from .app import ANY_ADDRESS, build_app
from .serve import serve
from .workbench import Workbench

__all__ = ["ANY_ADDRESS", "Workbench", "build_app", "serve"]
