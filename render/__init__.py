"""The light of a scene, as a camera gets it: integrators, cubes, sensors."""
