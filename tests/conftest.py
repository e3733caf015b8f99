"""Settings of all tests."""

from hypothesis import settings

# A machine that does other work must not fail a law, and the same tree must not pass today and fail tomorrow.
settings.register_profile("sensorgate", deadline=None, derandomize=True)
settings.load_profile("sensorgate")
