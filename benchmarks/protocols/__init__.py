"""Exploration by the protocols of other projects, on data that the user has.

Each module is a command of its own, which takes the folder of a clone or of other data of the
user's. Nothing of these projects is in this repository.
"""
