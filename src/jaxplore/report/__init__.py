"""What a run leaves behind: numbers, pictures, an animation, and the folder that holds them."""
