"""What joins the rooms: stages with their caches, batches of runs, campaigns, one executor, progress."""
