"""The WebODM plugin: the verdict before the upload, the right tasks after it."""
