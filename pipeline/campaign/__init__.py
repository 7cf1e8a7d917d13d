"""Many runs: found, analysed side by side, kept beside their reasons where they fail, put into one table and one page."""
