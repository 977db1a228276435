"""The gap between the twin and a rig on disk: cases, diagnoses, sealed challenges, the explained twin in use."""
