"""The front end: images of a stereo pair in, tracks out. It is thin, on OpenCV (the extra ``images``)."""
