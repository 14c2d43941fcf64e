"""What hpcomp asks of the system: whole outputs, depfiles, dates, signals, threads."""
