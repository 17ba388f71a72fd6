"""Tools of the repository: they make what is shipped and the pictures of the docs."""
