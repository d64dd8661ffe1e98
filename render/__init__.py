"""The light of a scene, as a camera gets it: integrators, cubes, sensors."""

from .llvm import choose_llvm

choose_llvm()
