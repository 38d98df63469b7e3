"""Cars and their tyres: vehicle files, data sheets, tyre files, domains, plants."""
