"""What a run left in its folder, and the images of its recording."""
