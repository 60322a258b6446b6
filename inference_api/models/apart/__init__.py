"""Child processes for all that talks to the registry or touches a bundle that is not verified yet.

A registry may trickle, lie or hang, and a bundle's graph may loop or eat memory. Neither can be interrupted
within a process, so both happen in processes of their own, which are ended when they are late.
``lookups`` and ``loading`` are the two roles, with the ports that the parent sees them through; their jobs
run in ``processes``, whose ``child`` is the parent's side, ``serving`` the child's, ``wire`` what goes
between them.
"""
