"""The gap between the twin and a rig on disk: cases, diagnoses, challenges, the twin in use."""
