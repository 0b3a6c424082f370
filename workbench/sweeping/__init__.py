"""Error against run time: settings of stages tried one by one, and which of them to take."""
