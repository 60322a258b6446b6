"""The HTTP service that answers ``POST /sample``: pictures in, configurations out.

A request comes through ``connections``, ``guards`` and ``telemetry`` to one of the ``pages`` or to
``open_inference``; its body is read by ``bodies``, it waits in ``turns``, and one of the ``models`` answers.
"""
