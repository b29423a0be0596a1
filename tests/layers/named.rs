//! What a source file names.

use std::collections::{BTreeMap, BTreeSet};

use syn::visit::Visit;

/// A path of modules from the crate's root.
pub type Place = Vec<String>;

pub fn place(path: &str) -> Place {
    path.split("::")
        .filter(|name| !name.is_empty())
        .map(str::to_owned)
        .collect()
}

/// What a file names, `use` trees flattened and inline paths too, as written and from the root.
pub struct Named<'a> {
    pub own: Place,
    pub modules: &'a BTreeSet<Place>,
    pub written: Vec<String>,
    pub places: Vec<Place>,
    /// Names that the file takes in, and may lend out.
    pub taken: BTreeMap<String, Place>,
    /// Modules that are of its tests.
    pub tests: Vec<Place>,
}

impl Named<'_> {
    fn add(&mut self, path: &str) -> Option<Place> {
        self.written.push(path.to_owned());
        let names = place(path);
        let up = names.iter().take_while(|name| *name == "super").count();
        let found = match names.first()?.as_str() {
            "crate" => [&self.own[..1], &names[1..]].concat(),
            "self" => [&self.own[..], &names[1..]].concat(),
            "super" => [
                self.own.get(..self.own.len().checked_sub(up)?)?,
                &names[up..],
            ]
            .concat(),
            first if first.starts_with("wingd_") => {
                let krate = first.trim_start_matches("wingd_").to_owned();
                [&[krate], &names[1..]].concat()
            }
            first => {
                let child = [&self.own[..], &[first.to_owned()]].concat();
                self.modules
                    .contains(&child)
                    .then(|| [&self.own[..], &names[..]].concat())?
            }
        };
        self.places.push(found.clone());
        Some(found)
    }

    fn take_in(&mut self, tree: &syn::UseTree, prefix: &str) {
        let join = |name: &syn::Ident| format!("{prefix}{name}");
        let (path, name) = match tree {
            syn::UseTree::Path(p) => {
                return self.take_in(&p.tree, &format!("{}::", join(&p.ident)));
            }
            syn::UseTree::Group(g) => {
                return g.items.iter().for_each(|tree| self.take_in(tree, prefix));
            }
            syn::UseTree::Glob(_) => (prefix.trim_end_matches("::").to_owned(), None),
            syn::UseTree::Name(n) if n.ident == "self" => {
                let path = prefix.trim_end_matches("::");
                (path.to_owned(), path.rsplit("::").next().map(str::to_owned))
            }
            syn::UseTree::Name(n) => (join(&n.ident), Some(n.ident.to_string())),
            syn::UseTree::Rename(r) => (join(&r.ident), Some(r.rename.to_string())),
        };
        let found = self.add(&path);
        self.taken.extend(name.zip(found));
    }
}

impl<'a> Visit<'a> for Named<'_> {
    fn visit_item_mod(&mut self, module: &'a syn::ItemMod) {
        let for_tests = module.attrs.iter().any(|a| {
            a.path().is_ident("cfg")
                && a.parse_args::<syn::Ident>()
                    .is_ok_and(|word| word == "test")
        });
        self.own.push(module.ident.to_string());
        if for_tests {
            self.tests.push(self.own.clone());
        } else {
            syn::visit::visit_item_mod(self, module);
        }
        self.own.pop();
    }

    fn visit_visibility(&mut self, _: &'a syn::Visibility) {}

    fn visit_item_use(&mut self, item: &'a syn::ItemUse) {
        self.take_in(&item.tree, "");
    }

    fn visit_path(&mut self, path: &'a syn::Path) {
        let names: Vec<String> = path.segments.iter().map(|s| s.ident.to_string()).collect();
        self.add(&names.join("::"));
        syn::visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, call: &'a syn::Macro) {
        let text = call.tokens.to_string().replace(" :: ", "::");
        let words = text.split(|c: char| !c.is_alphanumeric() && !"_:".contains(c));
        words
            .filter(|word| word.contains("::"))
            .for_each(|path| drop(self.add(path)));
        syn::visit::visit_macro(self, call);
    }
}
