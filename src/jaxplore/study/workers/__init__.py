"""Jobs spread over processes or the workers of a Ray cluster, whatever the jobs are."""
