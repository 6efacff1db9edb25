"""Scenes of the browser: what each kind of task draws of itself."""
