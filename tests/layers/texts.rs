//! Names and texts of a source file: types, doc comments, strings.

use syn::visit::Visit;

/// Names and texts of the sources outside their tests, each with its file.
#[derive(Default)]
pub struct Texts {
    /// File and name.
    pub types: Vec<(String, String)>,
    /// File and text, one block an item.
    pub docs: Vec<(String, String)>,
    /// File and literal.
    pub strings: Vec<(String, String)>,
    /// Public items without a doc comment.
    pub undocumented: Vec<String>,
    file: String,
}

fn is_for_tests(attributes: &[syn::Attribute]) -> bool {
    let only = |a: &syn::Attribute| {
        a.meta
            .require_list()
            .is_ok_and(|list| list.tokens.to_string() == "test")
    };
    attributes
        .iter()
        .any(|a| a.path().is_ident("test") || a.path().is_ident("cfg") && only(a))
}

fn doc(attributes: &[syn::Attribute]) -> Option<String> {
    let line = |a: &syn::Attribute| match &a.meta.require_name_value().ok()?.value {
        syn::Expr::Lit(syn::ExprLit {
            lit: syn::Lit::Str(text),
            ..
        }) => Some(text.value()),
        _ => None,
    };
    let lines = attributes
        .iter()
        .filter(|a| a.path().is_ident("doc"))
        .filter_map(line);
    Some(lines.collect::<Vec<_>>().join("\n")).filter(|text| !text.trim().is_empty())
}

impl Texts {
    /// Reads files by path and text; files of tests alone are not among them.
    pub fn read(files: &[(String, String)]) -> Self {
        let mut texts = Self::default();
        let parsed = files
            .iter()
            .map(|(path, text)| (path, syn::parse_file(text).expect("source parses")));
        let parsed: Vec<_> = parsed.collect();
        let for_tests: Vec<String> = parsed
            .iter()
            .flat_map(|(path, file)| test_modules(path, file))
            .collect();
        for (path, file) in parsed {
            let of_tests = |folder: &String| {
                path.strip_prefix(folder.as_str())
                    .is_some_and(|rest| rest.starts_with(['/', '.']))
            };
            if !for_tests.iter().any(of_tests) {
                texts.file.clone_from(path);
                texts.add_doc(&file.attrs);
                texts.visit_file(&file);
            }
        }
        texts
    }

    fn add_doc(&mut self, attributes: &[syn::Attribute]) -> bool {
        let text = doc(attributes);
        let there = text.is_some();
        self.docs.extend(text.map(|text| (self.file.clone(), text)));
        there
    }

    /// Notes a named item, and whether it lacks a doc comment.
    fn add_item(
        &mut self,
        attributes: &[syn::Attribute],
        visibility: Option<&syn::Visibility>,
        name: &syn::Ident,
    ) {
        let public = matches!(visibility, Some(syn::Visibility::Public(_)));
        if !self.add_doc(attributes) && public {
            self.undocumented.push(format!("{}: {name}", self.file));
        }
    }

    fn add_type(
        &mut self,
        attributes: &[syn::Attribute],
        visibility: Option<&syn::Visibility>,
        name: &syn::Ident,
    ) {
        self.add_item(attributes, visibility, name);
        self.types.push((self.file.clone(), name.to_string()));
    }

    fn add_tokens(&mut self, tokens: &impl ToString) {
        let literal = |text: &str| syn::parse_str::<syn::LitStr>(text).ok().map(|l| l.value());
        self.strings.extend(
            literals(&tokens.to_string())
                .filter_map(literal)
                .map(|s| (self.file.clone(), s)),
        );
    }
}

/// String literals of a token stream as text.
fn literals(tokens: &str) -> impl Iterator<Item = &str> {
    let mut rest = tokens;
    std::iter::from_fn(move || {
        let begin = rest.find('"')?;
        let inside = &rest[begin + 1..];
        let mut escaped = false;
        let closes = |c: char| {
            let ends = c == '"' && !escaped;
            escaped = c == '\\' && !escaped;
            ends
        };
        let end = inside.find(closes)?;
        let found = &rest[begin..begin + end + 2];
        rest = &inside[end + 1..];
        Some(found)
    })
}

/// Paths, without ending, of the modules that a file declares for its tests alone.
fn test_modules(path: &str, file: &syn::File) -> Vec<String> {
    let stem = path.trim_end_matches(".rs");
    let folder = match stem.rsplit_once('/') {
        Some((folder, "mod" | "lib")) => folder,
        _ => stem,
    };
    let module = |item: &syn::Item| match item {
        syn::Item::Mod(m) if is_for_tests(&m.attrs) && m.content.is_none() => {
            Some(format!("{folder}/{}", m.ident))
        }
        _ => None,
    };
    file.items.iter().filter_map(module).collect()
}

impl<'a> Visit<'a> for Texts {
    fn visit_item_mod(&mut self, item: &'a syn::ItemMod) {
        if !is_for_tests(&item.attrs) {
            self.add_doc(&item.attrs);
            syn::visit::visit_item_mod(self, item);
        }
    }

    fn visit_item_fn(&mut self, item: &'a syn::ItemFn) {
        if !is_for_tests(&item.attrs) {
            self.add_item(&item.attrs, Some(&item.vis), &item.sig.ident);
            syn::visit::visit_item_fn(self, item);
        }
    }

    fn visit_item_impl(&mut self, item: &'a syn::ItemImpl) {
        if !is_for_tests(&item.attrs) {
            syn::visit::visit_item_impl(self, item);
        }
    }

    fn visit_impl_item_fn(&mut self, item: &'a syn::ImplItemFn) {
        if !is_for_tests(&item.attrs) {
            self.add_item(&item.attrs, Some(&item.vis), &item.sig.ident);
            syn::visit::visit_impl_item_fn(self, item);
        }
    }

    fn visit_trait_item_fn(&mut self, item: &'a syn::TraitItemFn) {
        self.add_item(&item.attrs, None, &item.sig.ident);
        syn::visit::visit_trait_item_fn(self, item);
    }

    fn visit_item_trait(&mut self, item: &'a syn::ItemTrait) {
        self.add_type(&item.attrs, Some(&item.vis), &item.ident);
        syn::visit::visit_item_trait(self, item);
    }

    fn visit_item_struct(&mut self, item: &'a syn::ItemStruct) {
        if !is_for_tests(&item.attrs) {
            self.add_type(&item.attrs, Some(&item.vis), &item.ident);
            syn::visit::visit_item_struct(self, item);
        }
    }

    fn visit_item_enum(&mut self, item: &'a syn::ItemEnum) {
        if !is_for_tests(&item.attrs) {
            self.add_type(&item.attrs, Some(&item.vis), &item.ident);
            syn::visit::visit_item_enum(self, item);
        }
    }

    fn visit_item_type(&mut self, item: &'a syn::ItemType) {
        self.add_type(&item.attrs, Some(&item.vis), &item.ident);
        syn::visit::visit_item_type(self, item);
    }

    fn visit_item_const(&mut self, item: &'a syn::ItemConst) {
        if !is_for_tests(&item.attrs) {
            self.add_item(&item.attrs, Some(&item.vis), &item.ident);
            syn::visit::visit_item_const(self, item);
        }
    }

    fn visit_impl_item_const(&mut self, item: &'a syn::ImplItemConst) {
        self.add_item(&item.attrs, Some(&item.vis), &item.ident);
        syn::visit::visit_impl_item_const(self, item);
    }

    fn visit_field(&mut self, field: &'a syn::Field) {
        self.add_doc(&field.attrs);
        syn::visit::visit_field(self, field);
    }

    fn visit_variant(&mut self, variant: &'a syn::Variant) {
        self.add_doc(&variant.attrs);
        syn::visit::visit_variant(self, variant);
    }

    fn visit_lit_str(&mut self, literal: &'a syn::LitStr) {
        self.strings.push((self.file.clone(), literal.value()));
    }

    fn visit_macro(&mut self, item: &'a syn::Macro) {
        self.add_tokens(&item.tokens);
    }

    fn visit_attribute(&mut self, attribute: &'a syn::Attribute) {
        if let syn::Meta::List(list) = &attribute.meta
            && !attribute.path().is_ident("cfg")
        {
            self.add_tokens(&list.tokens);
        }
    }
}
