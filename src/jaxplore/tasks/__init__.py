"""Kinds of tasks: a folder and a row of the registry for each."""
