"""From a scene to its paths: images of the sources and the intervals in which each is heard."""
