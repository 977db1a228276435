"""A second implementation of the rig, kept apart from `softcal.core.twin`, that makes cases whose cause is sealed.

Nothing here may import the twin, the profiles or the diagnosis: a generator that shares code with
what it examines would share its mistakes.
"""
