"""The blind check of the diagnosis: campaigns whose truth is sealed, answers from the folders alone, and the score."""
