"""A second implementation of the rig, apart from `softcal.core.twin`: its cases have sealed causes.

Nothing here may import the twin, the profiles or the diagnosis: a generator that shares code with
what it examines would share its mistakes.
"""
