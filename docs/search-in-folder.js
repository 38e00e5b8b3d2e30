// A browser that opens the site from a folder starts no worker of the search and reads no file of
// its words: both come as scripts there (studies/documentation.py writes the words as one).
if (location.protocol === "file:") {
  window.Worker = class {
    postMessage({ init, query }) {
      const answer = (data) => this.onmessage({ data });
      if (init) {
        this.load(["lunr.js", "search_index.js"], () => {
          const { config, docs } = window.searchIndex;
          this.pages = Object.fromEntries(docs.map((page) => [page.location, page]));
          this.index = lunr(function () {
            this.field("title");
            this.field("text");
            this.ref("location");
            docs.forEach((page) => this.add(page));
          });
          answer({ config });
          answer({ allowSearch: true });
        });
      } else {
        const pages = this.index.search(query).map(({ ref }) => this.pages[ref]);
        answer({ results: pages.map((page) => ({ ...page, summary: page.text.slice(0, 200) })) });
      }
    }
    load([name, ...names], then) {
      const script = document.createElement("script");
      script.src = `${base_url}/search/${name}`;
      script.onload = () => (names.length ? this.load(names, then) : then());
      document.head.append(script);
    }
  };
}
