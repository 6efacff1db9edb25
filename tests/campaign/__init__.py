"""A campaign of bad input, kills and full disks against the command line.

`cases` and `mutations` generate input. `command` runs the command line in this process, `kills`
and `machines` run it as a process. `outcomes` judges every call. The tests run a part of it,
`make campaign` all of it.
"""
