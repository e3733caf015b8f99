"""The folder that a NodeODM takes as its ``odm_path``: sensorgate ahead of ODM on every task."""
