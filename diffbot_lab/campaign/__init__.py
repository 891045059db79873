"""Monte-Carlo campaigns over grids of parameters, resumable, with statistics and a report."""
