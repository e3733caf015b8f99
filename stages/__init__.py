"""What happens to the imagery: cameras and pixels, nothing of ODM."""
