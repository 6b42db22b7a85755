"""The live view without ROS: the page, the server that hands it out, and what a page may ask for."""
