"""Settings of all tests."""

from hypothesis import settings

# A machine that does other work must not fail a law.
settings.register_profile("sensorgate", deadline=None)
settings.load_profile("sensorgate")
