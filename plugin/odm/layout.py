"""What ODM calls the files of a project folder: what it reads there, and the products that others take from it."""

from __future__ import annotations

IMAGES = "images"
GCP_FILE = "gcp_list.txt"
GEO_FILE = "geo.txt"
IMAGE_GROUPS = "image_groups.txt"

ORTHOPHOTO = ("odm_orthophoto", "odm_orthophoto.tif")
# The georeferenced points of one block: what ODM's ``align`` takes to lay another on.
ALIGN_PRODUCT = ("odm_georeferencing", "odm_georeferenced_model.laz")
# Small files by which a finished run is judged.
EVIDENCE = (
    "odm_report",
    "log.json",
    "images.json",
    "cameras.json",
    "task_output.txt",
    "opensfm/stats/stats.json",
    "opensfm/reports",
)
