"""Methods × metrics × data, always beside what the data themselves allow."""
