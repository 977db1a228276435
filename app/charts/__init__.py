"""The figures of the screens and of the HTML reports: numbers in, a Plotly figure out."""
